-- Whom a recommendation was for stands with it, no longer in its advice: what many machines and tools are told alike is kept
-- once. Rows of before have it in their advice, and are not touched. And checkpoints stand in an ordinary table, as folds
-- do: a row of some kilobytes is too large for an index, in which it takes a second page.

ALTER TABLE recommendations ADD COLUMN operation_id TEXT
    CONSTRAINT recommendations_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128);
ALTER TABLE recommendations ADD COLUMN tool_id TEXT
    CONSTRAINT recommendations_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128);

CREATE TABLE tool_wear_checkpoint_rows (
    machine_id TEXT NOT NULL
        CONSTRAINT tool_wear_checkpoints_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT NOT NULL
        CONSTRAINT tool_wear_checkpoints_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    folded INTEGER NOT NULL
        CONSTRAINT tool_wear_checkpoints_folded_range CHECK (folded BETWEEN 1 AND 9007199254740991),
    fold_version INTEGER NOT NULL
        CONSTRAINT tool_wear_checkpoints_fold_version_range CHECK (fold_version BETWEEN 0 AND 65535),
    last_started_at_us INTEGER NOT NULL,
    last_seq INTEGER,
    last_cycle_id TEXT NOT NULL
        CONSTRAINT tool_wear_checkpoints_last_cycle_id_length CHECK (length(last_cycle_id) BETWEEN 1 AND 128),
    state BLOB NOT NULL,
    PRIMARY KEY (machine_id, tool_id, folded)
) STRICT;

INSERT INTO tool_wear_checkpoint_rows
SELECT machine_id, tool_id, folded, fold_version, last_started_at_us, last_seq, last_cycle_id, state
FROM tool_wear_checkpoints ORDER BY machine_id, tool_id, folded;

DROP TABLE tool_wear_checkpoints;
ALTER TABLE tool_wear_checkpoint_rows RENAME TO tool_wear_checkpoints;
