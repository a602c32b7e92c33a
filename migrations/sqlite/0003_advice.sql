-- What was handed out and what is wrong: recommendations and alarms.
-- A recommendation is stored for every cycle, so that which advice a cycle followed can be told for ever; what repeats
-- from one to the next stands once, in advices, under the hash of its text.

CREATE TABLE advices (
    advice_hash BLOB PRIMARY KEY NOT NULL
        CONSTRAINT advices_advice_hash_length CHECK (length(advice_hash) = 16),
    body TEXT NOT NULL
) WITHOUT ROWID, STRICT;

CREATE TABLE recommendations (
    recommendation_id TEXT PRIMARY KEY NOT NULL
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
    CONSTRAINT recommendations_level_whole CHECK (
        (level_as_run IS NOT NULL) + (level_lowest IS NOT NULL) + (level_highest IS NOT NULL) + (level_n IS NOT NULL) + (level_window IS NOT NULL) IN (0, 5)),
    CONSTRAINT recommendations_remaining_whole CHECK (
        (remaining_cycles IS NOT NULL) + (remaining_low IS NOT NULL) + (remaining_high IS NOT NULL) IN (0, 3))
) WITHOUT ROWID, STRICT;

CREATE TABLE alarms (
    alarm_id INTEGER PRIMARY KEY AUTOINCREMENT,
    kind TEXT NOT NULL
        CONSTRAINT alarms_kind_word
            CHECK (kind IN ('worn', 'broken_suspected', 'conditions_changed', 'overload', 'machine_silent', 'quarantine')),
    machine_id TEXT CONSTRAINT alarms_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT CONSTRAINT alarms_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    message TEXT NOT NULL CONSTRAINT alarms_message_length CHECK (length(message) BETWEEN 0 AND 10000),
    raised_at_us INTEGER NOT NULL,
    cleared_at_us INTEGER,
    acknowledged_by TEXT
        CONSTRAINT alarms_acknowledged_by_length CHECK (length(acknowledged_by) BETWEEN 0 AND 1000),
    acknowledged_at_us INTEGER,
    CONSTRAINT alarms_acknowledged_whole CHECK ((acknowledged_by IS NULL) = (acknowledged_at_us IS NULL))
) STRICT;

-- At most one alarm of a kind is open for one subject.
CREATE UNIQUE INDEX alarms_open ON alarms (kind, COALESCE(tool_id, ''), COALESCE(machine_id, ''))
    WHERE cleared_at_us IS NULL;
CREATE INDEX alarms_by_machine ON alarms (machine_id, alarm_id);
CREATE INDEX alarms_by_tool ON alarms (tool_id, alarm_id);
