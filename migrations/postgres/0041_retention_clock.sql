-- Up to when samples have aged. A clock that leaps ahead would drop all that is kept by days, for ever: so it follows the clock no
-- faster than some times what has surely gone by. It belongs to this database: neither a backup nor a copy takes it along.
CREATE TABLE retention_clock (
    only_row BIGINT PRIMARY KEY NOT NULL CONSTRAINT retention_clock_one_row CHECK (only_row = 1),
    aged_to_us BIGINT NOT NULL
);
