-- A recommendation stands for every cycle, so each byte of it counts: its id is the sixteen bytes that it is a text of, and a 1 behind
-- them where it asks for a reference cycle; its advice has ten bytes of a hash, among which a plant meets none twice; how long it
-- is valid is told instead of until when; and where the level as run is all there is to say, it is said once. An id of another form, which this program gives none, is its text.

ALTER TABLE advices DROP CONSTRAINT advices_advice_hash_length;
ALTER TABLE advices ALTER COLUMN advice_hash TYPE BYTEA USING substring(advice_hash FROM 1 FOR 10);
ALTER TABLE advices ADD CONSTRAINT advices_advice_hash_length CHECK (length(advice_hash) = 10);

ALTER TABLE recommendations DROP CONSTRAINT recommendations_recommendation_id_length;
ALTER TABLE recommendations
    ALTER COLUMN recommendation_id TYPE BYTEA USING
        CASE WHEN recommendation_id ~ '^[0-9a-f]{8}-([0-9a-f]{4}-){3}[0-9a-f]{12}$'
                 THEN decode(replace(recommendation_id, '-', ''), 'hex')
             WHEN recommendation_id ~ '^[0-9a-f]{8}-([0-9a-f]{4}-){3}[0-9a-f]{12}-reference$'
                 THEN decode(replace(left(recommendation_id, 36), '-', '') || '01', 'hex')
             ELSE convert_to(recommendation_id, 'UTF8')
        END,
    ALTER COLUMN advice_hash TYPE BYTEA USING substring(advice_hash FROM 1 FOR 10),
    ALTER COLUMN valid_until_us TYPE BIGINT USING valid_until_us - issued_at_us,
    ALTER COLUMN level_decides TYPE TEXT USING
        CASE WHEN level_as_run IS NOT NULL AND level_value IS NULL THEN 'as_run' ELSE level_decides END,
    ALTER COLUMN level_value TYPE DOUBLE PRECISION USING
        CASE WHEN level_decides IS NULL AND level_sd IS NULL AND level_value = level_as_run THEN NULL ELSE level_value END;
ALTER TABLE recommendations RENAME COLUMN valid_until_us TO valid_for_us;
ALTER TABLE recommendations ADD CONSTRAINT recommendations_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128);
