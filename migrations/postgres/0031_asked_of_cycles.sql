-- What its operation asked of a cycle when that was received: a cycle is judged by it, also where the operation has been changed
-- since. NULL where it asked for nothing, and of what was stored before. Whole numbers, as other quantities are counted.

-- Not validated: what stands there has none, and reading all of it would keep the table from servers that are still at work.

ALTER TABLE cycles ADD COLUMN asked_depth_um BIGINT, ADD COLUMN asked_speed_milli_rpm BIGINT;
ALTER TABLE cycles
    ADD CONSTRAINT cycles_asked_depth_um_range CHECK (asked_depth_um BETWEEN 0 AND 100000000) NOT VALID,
    ADD CONSTRAINT cycles_asked_speed_milli_rpm_range
        CHECK (asked_speed_milli_rpm BETWEEN 0 AND 1000000000) NOT VALID;
