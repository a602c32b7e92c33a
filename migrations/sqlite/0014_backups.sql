-- When the last backup was made, so that whoever watches is told when there has been none for long. It belongs to this
-- database: neither a backup nor a copy takes it along.
CREATE TABLE last_backup (
    only_row INTEGER PRIMARY KEY NOT NULL CONSTRAINT last_backup_one_row CHECK (only_row = 1),
    made_at_us INTEGER NOT NULL
) STRICT;
