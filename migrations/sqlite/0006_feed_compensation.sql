-- Wear that is compensated for the feed: energy over depth of each friction cycle, reference cycles, and what a level
-- rests on.

-- Way, time and energy of every millimetre of depth, quantised; what the fold needs of samples that may be gone. Cycles
-- from before have none and are judged as they were run.
ALTER TABLE cycles ADD COLUMN depth_digest BLOB
    CONSTRAINT cycles_depth_digest_length CHECK (length(depth_digest) BETWEEN 5 AND 1282);

ALTER TABLE operations ADD COLUMN reference_every_cycles INTEGER DEFAULT 50
    CONSTRAINT operations_reference_every_cycles_range CHECK (reference_every_cycles BETWEEN 2 AND 100000);
ALTER TABLE operations ADD COLUMN reference_feed_mm_min REAL
    CONSTRAINT operations_reference_feed_mm_min_range CHECK (reference_feed_mm_min BETWEEN 0.1 AND 100000.0);

-- The level that decides; level_decides is NULL where nothing decides, and all three are for advice from before.
ALTER TABLE recommendations ADD COLUMN level_decides TEXT
    CONSTRAINT recommendations_level_decides_word
        CHECK (level_decides IN ('as_run', 'feed_compensated', 'reference_cycles'));
ALTER TABLE recommendations ADD COLUMN level_value REAL
    CONSTRAINT recommendations_level_value_range CHECK (level_value BETWEEN -1000000.0 AND 1000000.0);
ALTER TABLE recommendations ADD COLUMN level_sd REAL
    CONSTRAINT recommendations_level_sd_range CHECK (level_sd BETWEEN 0.0 AND 1000000.0);
