-- A recommendation stands for every cycle, so each byte of it counts: its id is the sixteen bytes that it is a text of, and a 1 behind
-- them where it asks for a reference cycle. An id of another form, which this program gives none, is its text.

CREATE TABLE shorter_recommendations (
    recommendation_id BLOB NOT NULL
        CONSTRAINT recommendations_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128),
    advice_hash BLOB NOT NULL,
    issued_at_us INTEGER NOT NULL,
    valid_until_us INTEGER NOT NULL,
    level_as_run REAL
        CONSTRAINT recommendations_level_as_run_range CHECK (level_as_run BETWEEN -1000000.0 AND 1000000.0),
    level_lowest REAL
        CONSTRAINT recommendations_level_lowest_range CHECK (level_lowest BETWEEN -1000000.0 AND 1000000.0),
    level_highest REAL
        CONSTRAINT recommendations_level_highest_range CHECK (level_highest BETWEEN -1000000.0 AND 1000000.0),
    level_n INTEGER CONSTRAINT recommendations_level_n_range CHECK (level_n BETWEEN 0 AND 4294967295),
    level_window INTEGER
        CONSTRAINT recommendations_level_window_range CHECK (level_window BETWEEN 0 AND 4294967295),
    remaining_cycles INTEGER CONSTRAINT recommendations_remaining_cycles_range CHECK (remaining_cycles >= 0),
    remaining_low INTEGER CONSTRAINT recommendations_remaining_low_range CHECK (remaining_low >= 0),
    remaining_high INTEGER CONSTRAINT recommendations_remaining_high_range CHECK (remaining_high >= 0),
    data_age_ms INTEGER CONSTRAINT recommendations_data_age_ms_range CHECK (data_age_ms >= 0),
    machine_id TEXT NOT NULL
        CONSTRAINT recommendations_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    operation_id TEXT
        CONSTRAINT recommendations_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    tool_id TEXT CONSTRAINT recommendations_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    level_decides TEXT
        CONSTRAINT recommendations_level_decides_word
            CHECK (level_decides IN ('as_run', 'feed_compensated', 'reference_cycles')),
    level_value REAL
        CONSTRAINT recommendations_level_value_range CHECK (level_value BETWEEN -1000000.0 AND 1000000.0),
    level_sd REAL CONSTRAINT recommendations_level_sd_range CHECK (level_sd BETWEEN 0.0 AND 1000000.0),
    CONSTRAINT recommendations_level_whole CHECK (
        (level_as_run IS NOT NULL) + (level_lowest IS NOT NULL) + (level_highest IS NOT NULL) + (level_n IS NOT NULL) + (level_window IS NOT NULL) IN (0, 5)),
    CONSTRAINT recommendations_remaining_whole CHECK (
        (remaining_cycles IS NOT NULL) + (remaining_low IS NOT NULL) + (remaining_high IS NOT NULL) IN (0, 3)),
    -- An id says nothing of its machine, and is asked for alone.
    PRIMARY KEY (recommendation_id, machine_id)
) WITHOUT ROWID, STRICT;

INSERT INTO shorter_recommendations (recommendation_id, advice_hash, issued_at_us, valid_until_us, level_as_run, level_lowest,
    level_highest, level_n, level_window, remaining_cycles, remaining_low, remaining_high, data_age_ms, machine_id, operation_id,
    tool_id, level_decides, level_value, level_sd)
SELECT COALESCE(
           CASE WHEN recommendation_id NOT GLOB
                    '[0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f]-[0-9a-f][0-9a-f][0-9a-f][0-9a-f]-[0-9a-f][0-9a-f][0-9a-f][0-9a-f]-[0-9a-f][0-9a-f][0-9a-f][0-9a-f]-' ||
                    '[0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f][0-9a-f]*' THEN NULL
                WHEN length(recommendation_id) = 36 THEN unhex(replace(recommendation_id, '-', ''))
                WHEN length(recommendation_id) = 46 AND substr(recommendation_id, 37) = '-reference'
                    THEN unhex(replace(substr(recommendation_id, 1, 36), '-', '') || '01')
           END,
           CAST(recommendation_id AS BLOB)),
       advice_hash, issued_at_us, valid_until_us, level_as_run, level_lowest, level_highest,
       level_n, level_window, remaining_cycles, remaining_low, remaining_high, data_age_ms, machine_id, operation_id, tool_id,
       level_decides, level_value, level_sd
FROM recommendations WHERE TRUE ORDER BY recommendation_id, machine_id;
DROP TABLE recommendations;
ALTER TABLE shorter_recommendations RENAME TO recommendations;
