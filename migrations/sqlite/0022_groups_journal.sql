-- Which journal of groups belongs to this database, and which of its epochs was the last to be committed. Only SQLite
-- has one. A copy of the database has none: its server makes its own.
CREATE TABLE groups_journal (
    only_row INTEGER PRIMARY KEY NOT NULL CHECK (only_row = 1),
    journal_id BLOB NOT NULL CHECK (length(journal_id) = 16),
    epoch INTEGER NOT NULL CHECK (epoch >= 0)
) STRICT;
