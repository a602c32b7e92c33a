-- A partition in another schema was named without it: another table of that name was dropped in its place, and where there was none no later
-- partition was. Names are as the database writes them now, with the schema where that is needed, and no partition keeps the others.
CREATE OR REPLACE FUNCTION cycle_samples_partitions() RETURNS TABLE (name TEXT, from_us BIGINT, to_us BIGINT)
LANGUAGE sql STABLE AS $$
    SELECT relname, (bound[1])::BIGINT, (bound[2])::BIGINT FROM (
        SELECT c.oid::REGCLASS::TEXT AS relname,
               regexp_match(pg_get_expr(c.relpartbound, c.oid), 'FROM [(]''(-?[0-9]+)''[)] TO [(]''(-?[0-9]+)''[)]') AS bound
        FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid
        WHERE i.inhparent = 'cycle_samples'::regclass) AS found
    WHERE bound IS NOT NULL ORDER BY 2
$$;

CREATE OR REPLACE FUNCTION cycle_samples_drop_partition(until_us BIGINT)
RETURNS TABLE (machine_id TEXT, cycles BIGINT, bytes BIGINT) LANGUAGE plpgsql AS $$
DECLARE
    is_kept CONSTANT TEXT := 'SELECT EXISTS (SELECT 1 FROM %s AS s WHERE NOT EXISTS (
        SELECT 1 FROM sample_drops d WHERE d.machine_id = s.machine_id AND d.before_us >= $1) LIMIT 1)';
    part RECORD;
    kept BOOLEAN;
    went BOOLEAN;
    held_up TEXT;
    stays TEXT;
    why TEXT;
    machines TEXT[];
    counts BIGINT[];
    sizes BIGINT[];
BEGIN
    FOR part IN SELECT * FROM cycle_samples_partitions() AS p WHERE p.to_us <= until_us ORDER BY p.from_us LOOP
        went := FALSE;
        -- What is undone gives its locks back: nobody is held up by a partition that stays, nor the next one by who reads this.
        BEGIN
            EXECUTE format(is_kept, part.name) INTO kept USING part.to_us;
            IF kept THEN
                RAISE EXCEPTION 'it is kept' USING ERRCODE = 'FW001';
            END IF;
            IF to_regclass('pg_catalog.pg_dist_partition') IS NOT NULL THEN
                LOCK TABLE ONLY cycle_samples IN SHARE MODE;
            END IF;
            EXECUTE format('LOCK TABLE %s IN SHARE MODE', part.name);
            -- Statements of their own: they see what was committed until the lock was there.
            EXECUTE format(is_kept, part.name) INTO kept USING part.to_us;
            IF kept THEN
                RAISE EXCEPTION 'it is kept' USING ERRCODE = 'FW001';
            END IF;
            EXECUTE format(
                'SELECT array_agg(h.machine), array_agg(h.held), array_agg(h.size)
                 FROM (SELECT s.machine_id AS machine, count(*) AS held,
                              coalesce(sum(length(s.block)), 0)::BIGINT AS size
                       FROM %s AS s GROUP BY s.machine_id) AS h', part.name)
                INTO machines, counts, sizes;
            EXECUTE format('DROP TABLE %s', part.name);
            went := TRUE;
        EXCEPTION
            WHEN SQLSTATE 'FW001' THEN NULL;
            WHEN lock_not_available THEN
                -- Posts wait behind each that is tried. Who reads the table as a whole, as a backup does, holds up all of them.
                EXIT WHEN held_up IS NOT NULL;
                held_up := part.name;
            WHEN io_error OR data_corrupted OR index_corrupted OR disk_full OR deadlock_detected THEN RAISE;
            -- Somebody else's, or somebody has made something of it, or whatever else: it stays, and the others go.
            WHEN OTHERS THEN
                stays := part.name;
                why := SQLERRM;
        END;
        CONTINUE WHEN NOT went;
        RETURN QUERY SELECT * FROM unnest(machines, counts, sizes);
        RETURN QUERY SELECT NULL::TEXT, 0::BIGINT, 0::BIGINT;
        RETURN;
    END LOOP;
    IF held_up IS NOT NULL THEN
        RAISE EXCEPTION '% is in use', held_up USING ERRCODE = 'lock_not_available';
    END IF;
    IF stays IS NOT NULL THEN
        RAISE EXCEPTION 'the partition % cannot be dropped: %', stays, why USING ERRCODE = 'insufficient_privilege';
    END IF;
END $$;
