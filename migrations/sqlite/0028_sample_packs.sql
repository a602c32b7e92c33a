-- Blocks of samples that one group brings stand in one row, a pack, and each cycle says which and where in it. Before, a cycle's
-- samples had a row with a key, and an index beside it with the same key again: a hundred bytes a cycle, and pages that a row of a
-- kilobyte leaves half empty. A block of before is a pack of its own.

CREATE TABLE sample_packs (
    pack INTEGER PRIMARY KEY NOT NULL,
    blocks BLOB NOT NULL CONSTRAINT sample_packs_blocks_length CHECK (length(blocks) BETWEEN 1 AND 268435456)
) STRICT;

CREATE TABLE cycle_sample_rows (
    machine_id TEXT NOT NULL,
    received_at_us INTEGER NOT NULL,
    cycle_id TEXT NOT NULL,
    pack INTEGER NOT NULL,
    place INTEGER NOT NULL CONSTRAINT cycle_samples_place_range CHECK (place BETWEEN 0 AND 63),
    -- Of the block.
    bytes INTEGER NOT NULL CONSTRAINT cycle_samples_bytes_range CHECK (bytes BETWEEN 1 AND 268435456),
    PRIMARY KEY (machine_id, received_at_us, cycle_id)
) WITHOUT ROWID, STRICT;

-- Places of packs whose cycles have their samples no longer: what is in them is taken out by and by, a pack at a time.
CREATE TABLE sample_pack_drops (
    pack INTEGER NOT NULL,
    place INTEGER NOT NULL,
    PRIMARY KEY (pack, place)
) WITHOUT ROWID, STRICT;

INSERT INTO sample_packs (pack, blocks) SELECT rowid, block FROM cycle_samples ORDER BY rowid;

INSERT INTO cycle_sample_rows (machine_id, received_at_us, cycle_id, pack, place, bytes)
SELECT machine_id, received_at_us, cycle_id, rowid, 0, length(block) FROM cycle_samples
ORDER BY machine_id, received_at_us, cycle_id;

DROP TABLE cycle_samples;
ALTER TABLE cycle_sample_rows RENAME TO cycle_samples;

-- Whoever deletes: nothing stays in a pack unnoticed.
CREATE TRIGGER cycle_samples_dropped AFTER DELETE ON cycle_samples BEGIN
    INSERT INTO sample_pack_drops (pack, place) VALUES (OLD.pack, OLD.place) ON CONFLICT (pack, place) DO NOTHING;
END;
