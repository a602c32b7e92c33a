-- Streams: who holds a machine's, and what overrides the closed loop computed for a cycle.

-- One stream per machine, whatever server it is connected to. A row stays, so that its generation never comes again.
CREATE TABLE stream_leases (
    machine_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT stream_leases_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    holder TEXT COLLATE "C" NOT NULL CONSTRAINT stream_leases_holder_length CHECK (length(holder) BETWEEN 1 AND 128),
    generation BIGINT NOT NULL
        CONSTRAINT stream_leases_generation_range CHECK (generation BETWEEN 1 AND 9007199254740991),
    expires_at_us BIGINT NOT NULL
);

CREATE INDEX stream_leases_by_holder ON stream_leases (holder);

-- What each sample of a streamed cycle was answered, told or only computed; no part of the cycle's content.
CREATE TABLE cycle_overrides (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT cycle_overrides_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT COLLATE "C" NOT NULL CONSTRAINT cycle_overrides_cycle_id_length CHECK (length(cycle_id) BETWEEN 1 AND 128),
    mode TEXT NOT NULL CONSTRAINT cycle_overrides_mode_word CHECK (mode IN ('shadow', 'advise')),
    law_version TEXT NOT NULL
        CONSTRAINT cycle_overrides_law_version_length CHECK (length(law_version) BETWEEN 1 AND 64),
    program_hash TEXT CONSTRAINT cycle_overrides_program_hash_length CHECK (length(program_hash) = 64),
    stored_at_us BIGINT NOT NULL,
    block BYTEA NOT NULL CONSTRAINT cycle_overrides_block_length CHECK (length(block) BETWEEN 1 AND 16777216),
    PRIMARY KEY (machine_id, cycle_id)
);

-- The block is compressed already.
ALTER TABLE cycle_overrides ALTER COLUMN block SET STORAGE EXTERNAL;
