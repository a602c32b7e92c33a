-- States on the way over all machines of a tool that more than one has run: who asks how worn it is, and a late cycle, folds again only what
-- comes after one. Of a tool of one machine those of `tool_wear_checkpoints` are the same. The order key of the last folded cycle stands
-- beside the state.
CREATE TABLE tool_checkpoints (
    tool_id TEXT NOT NULL
        CONSTRAINT tool_checkpoints_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    folded INTEGER NOT NULL
        CONSTRAINT tool_checkpoints_folded_range CHECK (folded BETWEEN 1 AND 9007199254740991),
    fold_version INTEGER NOT NULL
        CONSTRAINT tool_checkpoints_fold_version_range CHECK (fold_version BETWEEN 0 AND 65535),
    last_started_at_us INTEGER NOT NULL,
    last_machine_id TEXT NOT NULL
        CONSTRAINT tool_checkpoints_last_machine_id_length CHECK (length(last_machine_id) BETWEEN 1 AND 128),
    last_seq INTEGER,
    last_cycle_id TEXT NOT NULL
        CONSTRAINT tool_checkpoints_last_cycle_id_length CHECK (length(last_cycle_id) BETWEEN 1 AND 128),
    state BLOB NOT NULL,
    PRIMARY KEY (tool_id, folded)
) STRICT;
