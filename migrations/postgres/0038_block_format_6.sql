-- Samples in block format 6 and content hashes of version 3 are stored from here on. No table changes, but a server of before could
-- not read the one and would tell a conflict by the other: it refuses a database that is newer than itself.

SELECT 1;
