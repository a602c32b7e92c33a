-- SQLite's cycles stand in the order in which they came from here on. PostgreSQL's always did.

SELECT 1;
