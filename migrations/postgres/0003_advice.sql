-- What was handed out and what is wrong: recommendations and alarms.
-- A recommendation is stored for every cycle, so that which advice a cycle followed can be told for ever; what repeats
-- from one to the next stands once, in advices, under the hash of its text.

CREATE TABLE advices (
    advice_hash BYTEA PRIMARY KEY NOT NULL
        CONSTRAINT advices_advice_hash_length CHECK (length(advice_hash) = 16),
    body TEXT NOT NULL
);

CREATE TABLE recommendations (
    recommendation_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT recommendations_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128),
    advice_hash BYTEA NOT NULL,
    issued_at_us BIGINT NOT NULL,
    valid_until_us BIGINT NOT NULL,
    level_as_run DOUBLE PRECISION
        CONSTRAINT recommendations_level_as_run_range CHECK (level_as_run BETWEEN -1000000.0 AND 1000000.0),
    level_lowest DOUBLE PRECISION
        CONSTRAINT recommendations_level_lowest_range CHECK (level_lowest BETWEEN -1000000.0 AND 1000000.0),
    level_highest DOUBLE PRECISION
        CONSTRAINT recommendations_level_highest_range CHECK (level_highest BETWEEN -1000000.0 AND 1000000.0),
    level_n BIGINT CONSTRAINT recommendations_level_n_range CHECK (level_n BETWEEN 0 AND 4294967295),
    level_window BIGINT
        CONSTRAINT recommendations_level_window_range CHECK (level_window BETWEEN 0 AND 4294967295),
    remaining_cycles BIGINT CONSTRAINT recommendations_remaining_cycles_range CHECK (remaining_cycles >= 0),
    remaining_low BIGINT CONSTRAINT recommendations_remaining_low_range CHECK (remaining_low >= 0),
    remaining_high BIGINT CONSTRAINT recommendations_remaining_high_range CHECK (remaining_high >= 0),
    data_age_ms BIGINT CONSTRAINT recommendations_data_age_ms_range CHECK (data_age_ms >= 0),
    CONSTRAINT recommendations_level_whole CHECK (
        num_nonnulls(level_as_run, level_lowest, level_highest, level_n, level_window) IN (0, 5)),
    CONSTRAINT recommendations_remaining_whole CHECK (
        num_nonnulls(remaining_cycles, remaining_low, remaining_high) IN (0, 3))
);

CREATE TABLE alarms (
    alarm_id BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    kind TEXT NOT NULL
        CONSTRAINT alarms_kind_word
            CHECK (kind IN ('worn', 'broken_suspected', 'conditions_changed', 'overload', 'machine_silent', 'quarantine')),
    machine_id TEXT COLLATE "C"
        CONSTRAINT alarms_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT COLLATE "C" CONSTRAINT alarms_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    message TEXT NOT NULL CONSTRAINT alarms_message_length CHECK (length(message) BETWEEN 0 AND 10000),
    raised_at_us BIGINT NOT NULL,
    cleared_at_us BIGINT,
    acknowledged_by TEXT
        CONSTRAINT alarms_acknowledged_by_length CHECK (length(acknowledged_by) BETWEEN 0 AND 1000),
    acknowledged_at_us BIGINT,
    CONSTRAINT alarms_acknowledged_whole CHECK ((acknowledged_by IS NULL) = (acknowledged_at_us IS NULL))
);

-- At most one alarm of a kind is open for one subject.
CREATE UNIQUE INDEX alarms_open ON alarms (kind, COALESCE(tool_id, ''), COALESCE(machine_id, ''))
    WHERE cleared_at_us IS NULL;
CREATE INDEX alarms_by_machine ON alarms (machine_id, alarm_id);
CREATE INDEX alarms_by_tool ON alarms (tool_id, alarm_id);
