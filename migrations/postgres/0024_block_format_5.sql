-- Samples in block format 5 are stored from here on. No table changes, but a server of before could not read them: it refuses a
-- database that is newer than itself.

SELECT 1;
