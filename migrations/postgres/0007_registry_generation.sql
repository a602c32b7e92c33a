-- Counts the changes of what is registered: machines, fitted lines, tools and their events, operations, models. Every
-- change counts up in its own transaction. What a server keeps in memory of them holds while the count it was read
-- under is the one in force; anything that writes these tables by other ways has to count up too.
CREATE TABLE registry_generation (
    registry_id BIGINT PRIMARY KEY NOT NULL CONSTRAINT registry_generation_one_row CHECK (registry_id = 1),
    generation BIGINT NOT NULL
        CONSTRAINT registry_generation_range CHECK (generation BETWEEN 1 AND 9007199254740991)
);

INSERT INTO registry_generation (registry_id, generation) VALUES (1, 1);
