-- What a partition holds is counted while nobody can write it any more: cycles that another server was just deleting one by one were
-- counted by both. Whoever reads goes on: only the drop itself needs all of it, and asks for the table before its partition, as
-- everybody does. Whether anything of it is kept is asked before, so that no one is held up by a partition that stays.
CREATE OR REPLACE FUNCTION cycle_samples_drop_partition(until_us BIGINT)
RETURNS TABLE (machine_id TEXT, cycles BIGINT, bytes BIGINT) LANGUAGE plpgsql AS $$
DECLARE
    part RECORD;
    kept BOOLEAN;
    machines TEXT[];
    counts BIGINT[];
    sizes BIGINT[];
BEGIN
    FOR part IN SELECT * FROM cycle_samples_partitions() AS p WHERE p.to_us <= until_us ORDER BY p.from_us LOOP
        EXECUTE format(
            'SELECT EXISTS (SELECT 1 FROM %I AS s WHERE NOT EXISTS (
                 SELECT 1 FROM sample_drops d WHERE d.machine_id = s.machine_id AND d.before_us >= $1))', part.name)
            INTO kept USING part.to_us;
        CONTINUE WHEN kept;
        EXECUTE format('LOCK TABLE %I IN SHARE MODE', part.name);
        -- A statement of its own: it sees what was committed until the lock was there.
        EXECUTE format(
            'SELECT bool_or(NOT EXISTS (
                        SELECT 1 FROM sample_drops d WHERE d.machine_id = h.machine AND d.before_us >= $1)),
                    array_agg(h.machine), array_agg(h.held), array_agg(h.size)
             FROM (SELECT s.machine_id AS machine, count(*) AS held,
                          coalesce(sum(length(s.block)), 0)::BIGINT AS size
                   FROM %I AS s GROUP BY s.machine_id) AS h', part.name)
            INTO kept, machines, counts, sizes USING part.to_us;
        CONTINUE WHEN kept;
        EXECUTE format('DROP TABLE %I', part.name);
        RETURN QUERY SELECT * FROM unnest(machines, counts, sizes);
        RETURN QUERY SELECT NULL::TEXT, 0::BIGINT, 0::BIGINT;
        RETURN;
    END LOOP;
END $$;
