-- Recommendations stand by their machine too, as everything does that grows with the cycles: what PostgreSQL spreads over
-- several nodes is spread by machine. And folds stand in an ordinary table: a row of some kilobytes is too large for an
-- index, in which it takes a second page that every cycle writes again.

CREATE TABLE recommendations_by_machine (
    recommendation_id TEXT NOT NULL
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
    level_decides TEXT
        CONSTRAINT recommendations_level_decides_word
            CHECK (level_decides IN ('as_run', 'feed_compensated', 'reference_cycles')),
    level_value REAL
        CONSTRAINT recommendations_level_value_range CHECK (level_value BETWEEN -1000000.0 AND 1000000.0),
    level_sd REAL CONSTRAINT recommendations_level_sd_range CHECK (level_sd BETWEEN 0.0 AND 1000000.0),
    machine_id TEXT NOT NULL
        CONSTRAINT recommendations_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    CONSTRAINT recommendations_level_whole CHECK (
        (level_as_run IS NOT NULL) + (level_lowest IS NOT NULL) + (level_highest IS NOT NULL) + (level_n IS NOT NULL) + (level_window IS NOT NULL) IN (0, 5)),
    CONSTRAINT recommendations_remaining_whole CHECK (
        (remaining_cycles IS NOT NULL) + (remaining_low IS NOT NULL) + (remaining_high IS NOT NULL) IN (0, 3)),
    -- An id says nothing of its machine, and is asked for alone.
    PRIMARY KEY (recommendation_id, machine_id)
) WITHOUT ROWID, STRICT;

-- Without its advice nobody knows whose one was; it is kept all the same.
INSERT INTO recommendations_by_machine
SELECT r.recommendation_id, r.advice_hash, r.issued_at_us, r.valid_until_us, r.level_as_run, r.level_lowest,
       r.level_highest, r.level_n, r.level_window, r.remaining_cycles, r.remaining_low, r.remaining_high, r.data_age_ms,
       r.level_decides, r.level_value, r.level_sd, COALESCE(json_extract(a.body, '$.machine'), 'unknown')
FROM recommendations r LEFT JOIN advices a ON a.advice_hash = r.advice_hash
ORDER BY r.recommendation_id;

DROP TABLE recommendations;
ALTER TABLE recommendations_by_machine RENAME TO recommendations;

CREATE TABLE tool_wear_rows (
    machine_id TEXT NOT NULL
        CONSTRAINT tool_wear_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT NOT NULL CONSTRAINT tool_wear_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    folded INTEGER NOT NULL CONSTRAINT tool_wear_folded_range CHECK (folded BETWEEN 0 AND 9007199254740991),
    fold_version INTEGER NOT NULL
        CONSTRAINT tool_wear_fold_version_range CHECK (fold_version BETWEEN 0 AND 65535),
    state BLOB NOT NULL,
    version INTEGER NOT NULL
        CONSTRAINT tool_wear_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us INTEGER NOT NULL,
    PRIMARY KEY (machine_id, tool_id)
) STRICT;

INSERT INTO tool_wear_rows
SELECT machine_id, tool_id, folded, fold_version, state, version, updated_at_us FROM tool_wear
ORDER BY machine_id, tool_id;

DROP TABLE tool_wear;
ALTER TABLE tool_wear_rows RENAME TO tool_wear;
CREATE INDEX tool_wear_by_tool ON tool_wear (tool_id, machine_id);
