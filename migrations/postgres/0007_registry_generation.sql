-- Counts the changes of what is registered: machines, fitted lines, tools and their events, operations, models. Every
-- change counts up one of these rows in its own transaction; the sum is the generation. Several rows, so that changes
-- at the same time seldom wait for each other. What a server keeps in memory of the registry holds while the generation
-- it was read under is the one in force; anything that writes these tables by other ways has to count up too.
CREATE TABLE registry_generation (
    registry_id BIGINT PRIMARY KEY NOT NULL CONSTRAINT registry_generation_rows CHECK (registry_id BETWEEN 0 AND 15),
    changes BIGINT NOT NULL CONSTRAINT registry_generation_changes_range CHECK (changes BETWEEN 0 AND 9007199254740991)
);

INSERT INTO registry_generation (registry_id, changes) VALUES
    (0, 1), (1, 0), (2, 0), (3, 0), (4, 0), (5, 0), (6, 0), (7, 0),
    (8, 0), (9, 0), (10, 0), (11, 0), (12, 0), (13, 0), (14, 0), (15, 0);
