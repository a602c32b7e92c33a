-- Cycles whose samples were dropped, each by its name: those that a clock which was ahead received and dropped at times that
-- are yet to come. A decision that tells of receipts up to such a time would also tell of what comes until then.
CREATE TABLE cycle_sample_drops (
    machine_id TEXT NOT NULL
        CONSTRAINT cycle_sample_drops_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT NOT NULL
        CONSTRAINT cycle_sample_drops_cycle_id_length CHECK (length(cycle_id) BETWEEN 1 AND 128),
    dropped_at_us INTEGER NOT NULL,
    reason TEXT NOT NULL CONSTRAINT cycle_sample_drops_reason_word CHECK (reason IN ('age', 'size')),
    PRIMARY KEY (machine_id, cycle_id)
) WITHOUT ROWID, STRICT;
