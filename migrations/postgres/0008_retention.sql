-- How long samples are kept, by machine, and what was dropped. Summaries are kept for ever.

-- A machine that is not here follows the server's settings; one with neither limit keeps its samples for ever.
CREATE TABLE retention (
    machine_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT retention_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    samples_days BIGINT CONSTRAINT retention_samples_days_range CHECK (samples_days BETWEEN 1 AND 36500),
    samples_bytes BIGINT
        CONSTRAINT retention_samples_bytes_range CHECK (samples_bytes BETWEEN 1 AND 9007199254740991),
    version BIGINT NOT NULL CONSTRAINT retention_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us BIGINT NOT NULL
);

-- Samples of a machine that were received before `before_us` are dropped: the row comes first, they go after it, and
-- the counts follow. Decisions of one day and reason share a row.
CREATE TABLE sample_drops (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT sample_drops_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    before_us BIGINT NOT NULL,
    dropped_at_us BIGINT NOT NULL,
    reason TEXT NOT NULL CONSTRAINT sample_drops_reason_word CHECK (reason IN ('age', 'size')),
    cycles BIGINT NOT NULL CONSTRAINT sample_drops_cycles_range CHECK (cycles BETWEEN 0 AND 9007199254740991),
    bytes BIGINT NOT NULL CONSTRAINT sample_drops_bytes_range CHECK (bytes BETWEEN 0 AND 9007199254740991),
    PRIMARY KEY (machine_id, before_us)
);

-- Partitions of samples that have a range, oldest first.
CREATE FUNCTION cycle_samples_partitions() RETURNS TABLE (name TEXT, from_us BIGINT, to_us BIGINT)
LANGUAGE sql STABLE AS $$
    SELECT relname, (bound[1])::BIGINT, (bound[2])::BIGINT FROM (
        SELECT c.relname::TEXT AS relname,
               regexp_match(pg_get_expr(c.relpartbound, c.oid), 'FROM \(''(-?\d+)''\) TO \(''(-?\d+)''\)') AS bound
        FROM pg_inherits i JOIN pg_class c ON c.oid = i.inhrelid
        WHERE i.inhparent = 'cycle_samples'::regclass) AS found
    WHERE bound IS NOT NULL ORDER BY 2
$$;

-- Drops the oldest partition that ends at or before `until_us` and of which every machine's samples are dropped by a
-- decision; returns what it held by machine, and a row without a machine that says it was done.
CREATE FUNCTION cycle_samples_drop_partition(until_us BIGINT)
RETURNS TABLE (machine_id TEXT, cycles BIGINT, bytes BIGINT) LANGUAGE plpgsql AS $$
DECLARE
    part RECORD;
    kept BOOLEAN;
BEGIN
    FOR part IN SELECT * FROM cycle_samples_partitions() AS p WHERE p.to_us <= until_us ORDER BY p.from_us LOOP
        EXECUTE format(
            'SELECT EXISTS (SELECT 1 FROM %I AS s WHERE NOT EXISTS (
                 SELECT 1 FROM sample_drops d WHERE d.machine_id = s.machine_id AND d.before_us >= $1))', part.name)
            INTO kept USING part.to_us;
        IF NOT kept THEN
            RETURN QUERY EXECUTE format(
                'SELECT s.machine_id, count(*), coalesce(sum(length(s.block)), 0)::BIGINT FROM %I AS s
                 GROUP BY s.machine_id', part.name);
            EXECUTE format('DROP TABLE %I', part.name);
            RETURN QUERY SELECT NULL::TEXT, 0::BIGINT, 0::BIGINT;
            RETURN;
        END IF;
    END LOOP;
END $$;
