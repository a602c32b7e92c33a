-- What a partition holds is counted once nobody can write it any more: cycles that another server was just deleting one by one were
-- counted by both. Whether anything of it is kept is asked before, so that nobody waits for a partition that stays.
CREATE OR REPLACE FUNCTION cycle_samples_drop_partition(until_us BIGINT)
RETURNS TABLE (machine_id TEXT, cycles BIGINT, bytes BIGINT) LANGUAGE plpgsql AS $$
DECLARE
    part RECORD;
    kept BOOLEAN;
    asks CONSTANT TEXT := 'SELECT EXISTS (SELECT 1 FROM %I AS s WHERE NOT EXISTS (
        SELECT 1 FROM sample_drops d WHERE d.machine_id = s.machine_id AND d.before_us >= $1))';
BEGIN
    FOR part IN SELECT * FROM cycle_samples_partitions() AS p WHERE p.to_us <= until_us ORDER BY p.from_us LOOP
        EXECUTE format(asks, part.name) INTO kept USING part.to_us;
        CONTINUE WHEN kept;
        EXECUTE format('LOCK TABLE %I IN ACCESS EXCLUSIVE MODE', part.name);
        -- A statement of its own: it sees what was committed until the lock was there.
        EXECUTE format(asks, part.name) INTO kept USING part.to_us;
        CONTINUE WHEN kept;
        RETURN QUERY EXECUTE format(
            'SELECT s.machine_id, count(*), coalesce(sum(length(s.block)), 0)::BIGINT FROM %I AS s
             GROUP BY s.machine_id', part.name);
        EXECUTE format('DROP TABLE %I', part.name);
        RETURN QUERY SELECT NULL::TEXT, 0::BIGINT, 0::BIGINT;
        RETURN;
    END LOOP;
END $$;
