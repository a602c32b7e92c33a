-- How each operation was turned over time: what an edge has cut counts at the depth and the diameter that were stated when it was cut.
-- What was stated first, or is when this is run, holds for what came before as well.

CREATE TABLE operation_setups (
    operation_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT operation_setups_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    from_us BIGINT NOT NULL,
    setup TEXT NOT NULL CONSTRAINT operation_setups_setup_length CHECK (length(setup) BETWEEN 2 AND 10000),
    PRIMARY KEY (operation_id, from_us)
);

INSERT INTO operation_setups (operation_id, from_us, setup)
SELECT operation_id, -9000000000000000000, setup FROM operations WHERE setup IS NOT NULL;
