-- Cycles, kept for ever, their samples, and the cached fold of wear.
-- Energy stands per basis with its parts. Idle power: subtracted from measured power where measured_power_idle_watts
-- is there; otherwise, in rated and in reported energy still included; dynamometer and calibrated energy have none.
-- reported_energy_joules is also the energy of the basis "reported".

CREATE TABLE cycles (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT cycles_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT cycles_cycle_id_length CHECK (length(cycle_id) BETWEEN 1 AND 128),
    tool_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT cycles_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    operation_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT cycles_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    started_at_us BIGINT NOT NULL,
    received_at_us BIGINT NOT NULL,
    seq BIGINT CONSTRAINT cycles_seq_range CHECK (seq >= 0),
    content_hash BYTEA NOT NULL CONSTRAINT cycles_content_hash_length CHECK (length(content_hash) = 32),
    process TEXT
        CONSTRAINT cycles_process_word
            CHECK (process IN ('friction', 'drilling', 'plunge', 'turning', 'vibratory', 'milling')),
    strategy TEXT CONSTRAINT cycles_strategy_word CHECK (strategy IN ('f_const', 'f_sec', 'f_lin', 'f_ac')),
    law_version TEXT CONSTRAINT cycles_law_version_length CHECK (length(law_version) BETWEEN 1 AND 64),
    profile_id TEXT COLLATE "C"
        CONSTRAINT cycles_profile_id_length CHECK (length(profile_id) BETWEEN 1 AND 128),
    profile_version BIGINT
        CONSTRAINT cycles_profile_version_range CHECK (profile_version BETWEEN 1 AND 4294967295),
    recommendation_id TEXT COLLATE "C"
        CONSTRAINT cycles_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128),
    outcome TEXT NOT NULL CONSTRAINT cycles_outcome_word CHECK (outcome IN ('completed', 'aborted')),
    summary_version BIGINT NOT NULL
        CONSTRAINT cycles_summary_version_range CHECK (summary_version BETWEEN 1 AND 4294967295),
    sample_count BIGINT NOT NULL
        CONSTRAINT cycles_sample_count_range CHECK (sample_count BETWEEN 0 AND 4294967295),
    coverage DOUBLE PRECISION NOT NULL CONSTRAINT cycles_coverage_range CHECK (coverage BETWEEN 0.0 AND 1.0),
    -- Fingerprint of the ratings and fitted lines that the best energy rests on: energies of another are not compared.
    energy_scale BIGINT NOT NULL,
    flags BIGINT NOT NULL CONSTRAINT cycles_flags_range CHECK (flags BETWEEN 0 AND 4294967295),
    -- How many of the quantities below are there. SQLite stores a NaN as NULL: the count shows it.
    quantities BIGINT NOT NULL,
    spindle_speed_rpm DOUBLE PRECISION
        CONSTRAINT cycles_spindle_speed_rpm_range CHECK (spindle_speed_rpm BETWEEN 0.0 AND 1000000.0),
    duration_ms DOUBLE PRECISION CONSTRAINT cycles_duration_ms_range CHECK (duration_ms BETWEEN 0.0 AND 1e9),
    dynamometer_joules DOUBLE PRECISION
        CONSTRAINT cycles_dynamometer_joules_range CHECK (dynamometer_joules BETWEEN -1e18 AND 1e18),
    dynamometer_spindle_joules DOUBLE PRECISION
        CONSTRAINT cycles_dynamometer_spindle_joules_range CHECK (dynamometer_spindle_joules BETWEEN -1e18 AND 1e18),
    dynamometer_feed_drive_joules DOUBLE PRECISION
        CONSTRAINT cycles_dynamometer_feed_drive_joules_range CHECK (dynamometer_feed_drive_joules BETWEEN -1e18 AND 1e18),
    calibrated_joules DOUBLE PRECISION
        CONSTRAINT cycles_calibrated_joules_range CHECK (calibrated_joules BETWEEN -1e18 AND 1e18),
    calibrated_spindle_joules DOUBLE PRECISION
        CONSTRAINT cycles_calibrated_spindle_joules_range CHECK (calibrated_spindle_joules BETWEEN -1e18 AND 1e18),
    calibrated_feed_drive_joules DOUBLE PRECISION
        CONSTRAINT cycles_calibrated_feed_drive_joules_range CHECK (calibrated_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_joules DOUBLE PRECISION
        CONSTRAINT cycles_measured_power_joules_range CHECK (measured_power_joules BETWEEN -1e18 AND 1e18),
    measured_power_spindle_joules DOUBLE PRECISION
        CONSTRAINT cycles_measured_power_spindle_joules_range CHECK (measured_power_spindle_joules BETWEEN -1e18 AND 1e18),
    measured_power_feed_drive_joules DOUBLE PRECISION
        CONSTRAINT cycles_measured_power_feed_drive_joules_range CHECK (measured_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_idle_watts DOUBLE PRECISION
        CONSTRAINT cycles_measured_power_idle_watts_range CHECK (measured_power_idle_watts BETWEEN -10000000.0 AND 10000000.0),
    rated_power_joules DOUBLE PRECISION
        CONSTRAINT cycles_rated_power_joules_range CHECK (rated_power_joules BETWEEN -1e18 AND 1e18),
    rated_power_spindle_joules DOUBLE PRECISION
        CONSTRAINT cycles_rated_power_spindle_joules_range CHECK (rated_power_spindle_joules BETWEEN -1e18 AND 1e18),
    rated_power_feed_drive_joules DOUBLE PRECISION
        CONSTRAINT cycles_rated_power_feed_drive_joules_range CHECK (rated_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    max_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_depth_mm_range CHECK (max_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_load_percent_range CHECK (max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    max_spindle_load_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_load_depth_mm_range CHECK (max_spindle_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_load_time_ms DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_load_time_ms_range CHECK (max_spindle_load_time_ms BETWEEN 0.0 AND 1e9),
    max_feed_drive_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_max_feed_drive_load_percent_range CHECK (max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    max_feed_drive_load_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_feed_drive_load_depth_mm_range CHECK (max_feed_drive_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_feed_drive_load_time_ms DOUBLE PRECISION
        CONSTRAINT cycles_max_feed_drive_load_time_ms_range CHECK (max_feed_drive_load_time_ms BETWEEN 0.0 AND 1e9),
    max_spindle_power_watts DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_power_watts_range CHECK (max_spindle_power_watts BETWEEN -10000000.0 AND 10000000.0),
    max_spindle_power_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_power_depth_mm_range CHECK (max_spindle_power_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_power_time_ms DOUBLE PRECISION
        CONSTRAINT cycles_max_spindle_power_time_ms_range CHECK (max_spindle_power_time_ms BETWEEN 0.0 AND 1e9),
    max_thrust_newtons DOUBLE PRECISION
        CONSTRAINT cycles_max_thrust_newtons_range CHECK (max_thrust_newtons BETWEEN -10000000.0 AND 10000000.0),
    max_thrust_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_thrust_depth_mm_range CHECK (max_thrust_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_thrust_time_ms DOUBLE PRECISION
        CONSTRAINT cycles_max_thrust_time_ms_range CHECK (max_thrust_time_ms BETWEEN 0.0 AND 1e9),
    max_torque_newton_metres DOUBLE PRECISION
        CONSTRAINT cycles_max_torque_newton_metres_range CHECK (max_torque_newton_metres BETWEEN -1000000.0 AND 1000000.0),
    max_torque_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_max_torque_depth_mm_range CHECK (max_torque_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_torque_time_ms DOUBLE PRECISION
        CONSTRAINT cycles_max_torque_time_ms_range CHECK (max_torque_time_ms BETWEEN 0.0 AND 1e9),
    mean_spindle_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_mean_spindle_load_percent_range CHECK (mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    mean_feed_drive_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_mean_feed_drive_load_percent_range CHECK (mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    mean_override_percent DOUBLE PRECISION
        CONSTRAINT cycles_mean_override_percent_range CHECK (mean_override_percent BETWEEN 0.0 AND 1000.0),
    operator_override_percent DOUBLE PRECISION
        CONSTRAINT cycles_operator_override_percent_range CHECK (operator_override_percent BETWEEN 0.0 AND 1000.0),
    median_spindle_speed_rpm DOUBLE PRECISION
        CONSTRAINT cycles_median_spindle_speed_rpm_range CHECK (median_spindle_speed_rpm BETWEEN -1000000.0 AND 1000000.0),
    spindle_load_fall_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_spindle_load_fall_depth_mm_range CHECK (spindle_load_fall_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_energy_joules DOUBLE PRECISION
        CONSTRAINT cycles_reported_energy_joules_range CHECK (reported_energy_joules BETWEEN -1e12 AND 1e12),
    reported_duration_ms DOUBLE PRECISION
        CONSTRAINT cycles_reported_duration_ms_range CHECK (reported_duration_ms BETWEEN 0.0 AND 86400000.0),
    reported_max_depth_mm DOUBLE PRECISION
        CONSTRAINT cycles_reported_max_depth_mm_range CHECK (reported_max_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_max_spindle_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_reported_max_spindle_load_percent_range CHECK (reported_max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_max_feed_drive_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_reported_max_feed_drive_load_percent_range CHECK (reported_max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_spindle_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_reported_mean_spindle_load_percent_range CHECK (reported_mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_feed_drive_load_percent DOUBLE PRECISION
        CONSTRAINT cycles_reported_mean_feed_drive_load_percent_range CHECK (reported_mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_operator_override_percent DOUBLE PRECISION
        CONSTRAINT cycles_reported_operator_override_percent_range CHECK (reported_operator_override_percent BETWEEN 0.0 AND 1000.0),
    CONSTRAINT cycles_quantities CHECK (quantities = num_nonnulls(
        spindle_speed_rpm, duration_ms, dynamometer_joules, dynamometer_spindle_joules,
        dynamometer_feed_drive_joules, calibrated_joules, calibrated_spindle_joules,
        calibrated_feed_drive_joules, measured_power_joules, measured_power_spindle_joules,
        measured_power_feed_drive_joules, measured_power_idle_watts, rated_power_joules,
        rated_power_spindle_joules, rated_power_feed_drive_joules, max_depth_mm,
        max_spindle_load_percent, max_spindle_load_depth_mm, max_spindle_load_time_ms,
        max_feed_drive_load_percent, max_feed_drive_load_depth_mm, max_feed_drive_load_time_ms,
        max_spindle_power_watts, max_spindle_power_depth_mm, max_spindle_power_time_ms,
        max_thrust_newtons, max_thrust_depth_mm, max_thrust_time_ms, max_torque_newton_metres,
        max_torque_depth_mm, max_torque_time_ms, mean_spindle_load_percent, mean_feed_drive_load_percent,
        mean_override_percent, operator_override_percent, median_spindle_speed_rpm,
        spindle_load_fall_depth_mm, reported_energy_joules, reported_duration_ms, reported_max_depth_mm,
        reported_max_spindle_load_percent, reported_max_feed_drive_load_percent,
        reported_mean_spindle_load_percent, reported_mean_feed_drive_load_percent,
        reported_operator_override_percent)),
    CONSTRAINT cycles_profile_whole CHECK ((profile_id IS NULL) = (profile_version IS NULL)),
    PRIMARY KEY (machine_id, cycle_id)
);

-- The order of the fold; cycles without a count of their own come before those with one.
CREATE INDEX cycles_by_tool ON cycles (tool_id, started_at_us, machine_id, COALESCE(seq, -1), cycle_id);
CREATE INDEX cycles_by_operation ON cycles (operation_id, started_at_us, machine_id, cycle_id);
CREATE INDEX cycles_by_machine ON cycles (machine_id, started_at_us, cycle_id);
CREATE INDEX cycles_by_time ON cycles (started_at_us, machine_id, cycle_id);

-- Samples of a cycle as one framed byte string, partitioned by receipt: a machine's wrong clock cannot miss a
-- partition, and retention drops partitions. The default partition keeps what no other one covers.
CREATE TABLE cycle_samples (
    machine_id TEXT COLLATE "C" NOT NULL,
    received_at_us BIGINT NOT NULL,
    cycle_id TEXT COLLATE "C" NOT NULL,
    block BYTEA NOT NULL CONSTRAINT cycle_samples_block_length CHECK (length(block) BETWEEN 1 AND 268435456),
    PRIMARY KEY (machine_id, received_at_us, cycle_id)
) PARTITION BY RANGE (received_at_us);

-- It is compressed already.
ALTER TABLE cycle_samples ALTER COLUMN block SET STORAGE EXTERNAL;

CREATE TABLE cycle_samples_default PARTITION OF cycle_samples DEFAULT;

-- Creates the partitions of `months` calendar months (UTC) from that of `from_us` on, or of as many days where
-- `step` is 'day'; returns how many it made. A month that the default partition already holds rows of stays there.
CREATE FUNCTION cycle_samples_make_partitions(from_us BIGINT, count INTEGER, step TEXT DEFAULT 'month')
RETURNS INTEGER LANGUAGE plpgsql AS $$
DECLARE
    width INTERVAL := ('1 ' || step)::INTERVAL;
    low TIMESTAMP := date_trunc(step, TIMESTAMP 'epoch' + from_us * INTERVAL '1 microsecond');
    made INTEGER := 0;
    name TEXT;
BEGIN
    IF step NOT IN ('month', 'day') THEN
        RAISE EXCEPTION 'step must be month or day, is %', step;
    END IF;
    IF count NOT BETWEEN 1 AND 400 THEN
        RAISE EXCEPTION 'count must be within 1 to 400, is %', count;
    END IF;
    FOR i IN 1 .. count LOOP
        name := 'cycle_samples_' || to_char(low, CASE step WHEN 'month' THEN 'YYYYMM' ELSE 'YYYYMMDD' END);
        IF to_regclass(name) IS NULL THEN
            BEGIN
                EXECUTE format('CREATE TABLE %I PARTITION OF cycle_samples FOR VALUES FROM (%s) TO (%s)', name,
                    (extract(epoch FROM low) * 1000000)::BIGINT, (extract(epoch FROM low + width) * 1000000)::BIGINT);
                made := made + 1;
            EXCEPTION WHEN check_violation OR invalid_object_definition THEN
                RAISE WARNING 'partition % is not made: rows or another partition stand in its place', name;
            END;
        END IF;
        low := low + width;
    END LOOP;
    RETURN made;
END $$;

-- One machine's fold of one tool: a cache, always equal to the fold over the cycles in their order.
CREATE TABLE tool_wear (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_wear_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_wear_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    folded BIGINT NOT NULL CONSTRAINT tool_wear_folded_range CHECK (folded BETWEEN 0 AND 9007199254740991),
    fold_version BIGINT NOT NULL
        CONSTRAINT tool_wear_fold_version_range CHECK (fold_version BETWEEN 0 AND 65535),
    state BYTEA NOT NULL,
    version BIGINT NOT NULL CONSTRAINT tool_wear_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us BIGINT NOT NULL,
    PRIMARY KEY (machine_id, tool_id)
);

-- States on the way, so that a late cycle refolds only what comes after it. The order key of the last folded
-- cycle stands beside the state.
CREATE TABLE tool_wear_checkpoints (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_wear_checkpoints_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    tool_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_wear_checkpoints_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    folded BIGINT NOT NULL
        CONSTRAINT tool_wear_checkpoints_folded_range CHECK (folded BETWEEN 1 AND 9007199254740991),
    fold_version BIGINT NOT NULL
        CONSTRAINT tool_wear_checkpoints_fold_version_range CHECK (fold_version BETWEEN 0 AND 65535),
    last_started_at_us BIGINT NOT NULL,
    last_seq BIGINT,
    last_cycle_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_wear_checkpoints_last_cycle_id_length CHECK (length(last_cycle_id) BETWEEN 1 AND 128),
    state BYTEA NOT NULL,
    PRIMARY KEY (machine_id, tool_id, folded)
);

CREATE INDEX tool_wear_by_tool ON tool_wear (tool_id, machine_id);
