-- Whether a month has its partition was asked by its name, which the search path found in any schema: beside another plant's tables, whose
-- schema came later in the path, no partition was ever made, and all samples stood in the default one, which retention empties row by
-- row instead of dropping it. It goes by the bounds of this table's own partitions now, wherever they stand, and a new one is made where the
-- table is.
CREATE OR REPLACE FUNCTION cycle_samples_make_partitions(from_us BIGINT, count INTEGER, step TEXT DEFAULT 'month')
RETURNS INTEGER LANGUAGE plpgsql AS $$
DECLARE
    width INTERVAL := ('1 ' || step)::INTERVAL;
    low TIMESTAMP := date_trunc(step, TIMESTAMP 'epoch' + from_us * INTERVAL '1 microsecond');
    home TEXT := (SELECT n.nspname FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace
                  WHERE c.oid = 'cycle_samples'::REGCLASS);
    made INTEGER := 0;
    name TEXT;
    first_us BIGINT;
    next_us BIGINT;
BEGIN
    IF step NOT IN ('month', 'day') THEN
        RAISE EXCEPTION 'step must be month or day, is %', step;
    END IF;
    IF count NOT BETWEEN 1 AND 400 THEN
        RAISE EXCEPTION 'count must be within 1 to 400, is %', count;
    END IF;
    FOR i IN 1 .. count LOOP
        name := 'cycle_samples_' || to_char(low, CASE step WHEN 'month' THEN 'YYYYMM' ELSE 'YYYYMMDD' END);
        first_us := (extract(epoch FROM low) * 1000000)::BIGINT;
        next_us := (extract(epoch FROM low + width) * 1000000)::BIGINT;
        -- Of its name there may be something else of this schema, as it always was: that is left alone.
        IF to_regclass(format('%I.%I', home, name)) IS NULL
            AND NOT EXISTS (SELECT 1 FROM cycle_samples_partitions() AS p
                            WHERE p.from_us <= first_us AND p.to_us >= next_us) THEN
            BEGIN
                EXECUTE format('CREATE TABLE %I.%I PARTITION OF %I.cycle_samples FOR VALUES FROM (%s) TO (%s)', home, name, home,
                    first_us, next_us);
                made := made + 1;
            EXCEPTION WHEN check_violation OR invalid_object_definition THEN
                RAISE WARNING 'partition % is not made: rows or another partition stand in its place', name;
            END;
        END IF;
        low := low + width;
    END LOOP;
    RETURN made;
END $$;
