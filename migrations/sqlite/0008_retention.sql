-- How long samples are kept, by machine, and what was dropped. Summaries are kept for ever.

-- A machine that is not here follows the server's settings; one with neither limit keeps its samples for ever.
CREATE TABLE retention (
    machine_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT retention_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    samples_days INTEGER CONSTRAINT retention_samples_days_range CHECK (samples_days BETWEEN 1 AND 36500),
    samples_bytes INTEGER
        CONSTRAINT retention_samples_bytes_range CHECK (samples_bytes BETWEEN 1 AND 9007199254740991),
    version INTEGER NOT NULL CONSTRAINT retention_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us INTEGER NOT NULL
) WITHOUT ROWID, STRICT;

-- Samples of a machine that were received before `before_us` are dropped: the row comes first, they go after it, and
-- the counts follow. Decisions of one day and reason share a row.
CREATE TABLE sample_drops (
    machine_id TEXT NOT NULL
        CONSTRAINT sample_drops_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    before_us INTEGER NOT NULL,
    dropped_at_us INTEGER NOT NULL,
    reason TEXT NOT NULL CONSTRAINT sample_drops_reason_word CHECK (reason IN ('age', 'size')),
    cycles INTEGER NOT NULL CONSTRAINT sample_drops_cycles_range CHECK (cycles BETWEEN 0 AND 9007199254740991),
    bytes INTEGER NOT NULL CONSTRAINT sample_drops_bytes_range CHECK (bytes BETWEEN 0 AND 9007199254740991),
    PRIMARY KEY (machine_id, before_us)
) WITHOUT ROWID, STRICT;
