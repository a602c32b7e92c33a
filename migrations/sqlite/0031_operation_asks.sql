-- What each operation asked for over time: a cycle is judged by the depth and the spindle speed that were asked for when it began.
-- What it asked for first, or asks for when this is run, holds for what came before as well.

CREATE TABLE operation_asks (
    operation_id TEXT NOT NULL
        CONSTRAINT operation_asks_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    from_us INTEGER NOT NULL,
    depth_mm REAL CONSTRAINT operation_asks_depth_mm_range CHECK (depth_mm BETWEEN 0.001 AND 100000.0),
    spindle_speed_rpm REAL
        CONSTRAINT operation_asks_spindle_speed_rpm_range CHECK (spindle_speed_rpm BETWEEN 0.0 AND 1000000.0),
    PRIMARY KEY (operation_id, from_us)
) STRICT, WITHOUT ROWID;

INSERT INTO operation_asks (operation_id, from_us, depth_mm, spindle_speed_rpm)
SELECT operation_id, -9000000000000000000, depth_mm, spindle_speed_rpm FROM operations;
