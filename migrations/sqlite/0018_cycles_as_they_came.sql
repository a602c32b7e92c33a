-- Cycles stand in an ordinary table, in the order in which they came: what machines post at once goes to one page. Before, a
-- machine's rows stood together, so that each cycle of a group wrote a page of its own, and now and then divided it with its
-- neighbours. Rows of before keep the order in which they stand: sorting them would take as much memory.

CREATE TABLE cycle_rows (
    machine_id TEXT NOT NULL CONSTRAINT cycles_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT NOT NULL CONSTRAINT cycles_cycle_id_length CHECK (length(cycle_id) BETWEEN 1 AND 128),
    tool_id TEXT NOT NULL CONSTRAINT cycles_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    operation_id TEXT NOT NULL
        CONSTRAINT cycles_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    started_at_us INTEGER NOT NULL,
    received_at_us INTEGER NOT NULL,
    seq INTEGER CONSTRAINT cycles_seq_range CHECK (seq >= 0),
    content_hash BLOB NOT NULL CONSTRAINT cycles_content_hash_length CHECK (length(content_hash) = 32),
    process TEXT
        CONSTRAINT cycles_process_word
            CHECK (process IN ('friction', 'drilling', 'plunge', 'turning', 'vibratory', 'milling')),
    strategy TEXT CONSTRAINT cycles_strategy_word CHECK (strategy IN ('f_const', 'f_sec', 'f_lin', 'f_ac')),
    law_version TEXT CONSTRAINT cycles_law_version_length CHECK (length(law_version) BETWEEN 1 AND 64),
    profile_id TEXT CONSTRAINT cycles_profile_id_length CHECK (length(profile_id) BETWEEN 1 AND 128),
    profile_version INTEGER
        CONSTRAINT cycles_profile_version_range CHECK (profile_version BETWEEN 1 AND 4294967295),
    recommendation_id TEXT
        CONSTRAINT cycles_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128),
    outcome TEXT NOT NULL CONSTRAINT cycles_outcome_word CHECK (outcome IN ('completed', 'aborted')),
    summary_version INTEGER NOT NULL
        CONSTRAINT cycles_summary_version_range CHECK (summary_version BETWEEN 1 AND 4294967295),
    sample_count INTEGER NOT NULL
        CONSTRAINT cycles_sample_count_range CHECK (sample_count BETWEEN 0 AND 4294967295),
    coverage REAL NOT NULL CONSTRAINT cycles_coverage_range CHECK (coverage BETWEEN 0.0 AND 1.0),
    -- Fingerprint of the ratings and fitted lines that the best energy rests on: energies of another are not compared.
    energy_scale INTEGER NOT NULL,
    flags INTEGER NOT NULL CONSTRAINT cycles_flags_range CHECK (flags BETWEEN 0 AND 4294967295),
    -- How many of the quantities below are there. SQLite stores a NaN as NULL: the count shows it.
    quantities INTEGER NOT NULL,
    spindle_speed_rpm REAL
        CONSTRAINT cycles_spindle_speed_rpm_range CHECK (spindle_speed_rpm BETWEEN 0.0 AND 1000000.0),
    duration_ms REAL CONSTRAINT cycles_duration_ms_range CHECK (duration_ms BETWEEN 0.0 AND 1e9),
    dynamometer_joules REAL
        CONSTRAINT cycles_dynamometer_joules_range CHECK (dynamometer_joules BETWEEN -1e18 AND 1e18),
    dynamometer_spindle_joules REAL
        CONSTRAINT cycles_dynamometer_spindle_joules_range CHECK (dynamometer_spindle_joules BETWEEN -1e18 AND 1e18),
    dynamometer_feed_drive_joules REAL
        CONSTRAINT cycles_dynamometer_feed_drive_joules_range CHECK (dynamometer_feed_drive_joules BETWEEN -1e18 AND 1e18),
    calibrated_joules REAL
        CONSTRAINT cycles_calibrated_joules_range CHECK (calibrated_joules BETWEEN -1e18 AND 1e18),
    calibrated_spindle_joules REAL
        CONSTRAINT cycles_calibrated_spindle_joules_range CHECK (calibrated_spindle_joules BETWEEN -1e18 AND 1e18),
    calibrated_feed_drive_joules REAL
        CONSTRAINT cycles_calibrated_feed_drive_joules_range CHECK (calibrated_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_joules REAL
        CONSTRAINT cycles_measured_power_joules_range CHECK (measured_power_joules BETWEEN -1e18 AND 1e18),
    measured_power_spindle_joules REAL
        CONSTRAINT cycles_measured_power_spindle_joules_range CHECK (measured_power_spindle_joules BETWEEN -1e18 AND 1e18),
    measured_power_feed_drive_joules REAL
        CONSTRAINT cycles_measured_power_feed_drive_joules_range CHECK (measured_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_idle_watts REAL
        CONSTRAINT cycles_measured_power_idle_watts_range CHECK (measured_power_idle_watts BETWEEN -10000000.0 AND 10000000.0),
    rated_power_joules REAL
        CONSTRAINT cycles_rated_power_joules_range CHECK (rated_power_joules BETWEEN -1e18 AND 1e18),
    rated_power_spindle_joules REAL
        CONSTRAINT cycles_rated_power_spindle_joules_range CHECK (rated_power_spindle_joules BETWEEN -1e18 AND 1e18),
    rated_power_feed_drive_joules REAL
        CONSTRAINT cycles_rated_power_feed_drive_joules_range CHECK (rated_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    max_depth_mm REAL
        CONSTRAINT cycles_max_depth_mm_range CHECK (max_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_load_percent REAL
        CONSTRAINT cycles_max_spindle_load_percent_range CHECK (max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    max_spindle_load_depth_mm REAL
        CONSTRAINT cycles_max_spindle_load_depth_mm_range CHECK (max_spindle_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_load_time_ms REAL
        CONSTRAINT cycles_max_spindle_load_time_ms_range CHECK (max_spindle_load_time_ms BETWEEN 0.0 AND 1e9),
    max_feed_drive_load_percent REAL
        CONSTRAINT cycles_max_feed_drive_load_percent_range CHECK (max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    max_feed_drive_load_depth_mm REAL
        CONSTRAINT cycles_max_feed_drive_load_depth_mm_range CHECK (max_feed_drive_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_feed_drive_load_time_ms REAL
        CONSTRAINT cycles_max_feed_drive_load_time_ms_range CHECK (max_feed_drive_load_time_ms BETWEEN 0.0 AND 1e9),
    max_spindle_power_watts REAL
        CONSTRAINT cycles_max_spindle_power_watts_range CHECK (max_spindle_power_watts BETWEEN -10000000.0 AND 10000000.0),
    max_spindle_power_depth_mm REAL
        CONSTRAINT cycles_max_spindle_power_depth_mm_range CHECK (max_spindle_power_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_power_time_ms REAL
        CONSTRAINT cycles_max_spindle_power_time_ms_range CHECK (max_spindle_power_time_ms BETWEEN 0.0 AND 1e9),
    max_thrust_newtons REAL
        CONSTRAINT cycles_max_thrust_newtons_range CHECK (max_thrust_newtons BETWEEN -10000000.0 AND 10000000.0),
    max_thrust_depth_mm REAL
        CONSTRAINT cycles_max_thrust_depth_mm_range CHECK (max_thrust_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_thrust_time_ms REAL
        CONSTRAINT cycles_max_thrust_time_ms_range CHECK (max_thrust_time_ms BETWEEN 0.0 AND 1e9),
    max_torque_newton_metres REAL
        CONSTRAINT cycles_max_torque_newton_metres_range CHECK (max_torque_newton_metres BETWEEN -1000000.0 AND 1000000.0),
    max_torque_depth_mm REAL
        CONSTRAINT cycles_max_torque_depth_mm_range CHECK (max_torque_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_torque_time_ms REAL
        CONSTRAINT cycles_max_torque_time_ms_range CHECK (max_torque_time_ms BETWEEN 0.0 AND 1e9),
    mean_spindle_load_percent REAL
        CONSTRAINT cycles_mean_spindle_load_percent_range CHECK (mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    mean_feed_drive_load_percent REAL
        CONSTRAINT cycles_mean_feed_drive_load_percent_range CHECK (mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    mean_override_percent REAL
        CONSTRAINT cycles_mean_override_percent_range CHECK (mean_override_percent BETWEEN 0.0 AND 1000.0),
    operator_override_percent REAL
        CONSTRAINT cycles_operator_override_percent_range CHECK (operator_override_percent BETWEEN 0.0 AND 1000.0),
    median_spindle_speed_rpm REAL
        CONSTRAINT cycles_median_spindle_speed_rpm_range CHECK (median_spindle_speed_rpm BETWEEN -1000000.0 AND 1000000.0),
    spindle_load_fall_depth_mm REAL
        CONSTRAINT cycles_spindle_load_fall_depth_mm_range CHECK (spindle_load_fall_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_energy_joules REAL
        CONSTRAINT cycles_reported_energy_joules_range CHECK (reported_energy_joules BETWEEN -1e12 AND 1e12),
    reported_duration_ms REAL
        CONSTRAINT cycles_reported_duration_ms_range CHECK (reported_duration_ms BETWEEN 0.0 AND 86400000.0),
    reported_max_depth_mm REAL
        CONSTRAINT cycles_reported_max_depth_mm_range CHECK (reported_max_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_max_spindle_load_percent REAL
        CONSTRAINT cycles_reported_max_spindle_load_percent_range CHECK (reported_max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_max_feed_drive_load_percent REAL
        CONSTRAINT cycles_reported_max_feed_drive_load_percent_range CHECK (reported_max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_spindle_load_percent REAL
        CONSTRAINT cycles_reported_mean_spindle_load_percent_range CHECK (reported_mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_feed_drive_load_percent REAL
        CONSTRAINT cycles_reported_mean_feed_drive_load_percent_range CHECK (reported_mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_operator_override_percent REAL
        CONSTRAINT cycles_reported_operator_override_percent_range CHECK (reported_operator_override_percent BETWEEN 0.0 AND 1000.0),
    depth_digest BLOB
        CONSTRAINT cycles_depth_digest_length CHECK (length(depth_digest) BETWEEN 5 AND 1282),
    CONSTRAINT cycles_quantities CHECK (quantities =
        (spindle_speed_rpm IS NOT NULL) + (duration_ms IS NOT NULL) + (dynamometer_joules IS NOT NULL) +
        (dynamometer_spindle_joules IS NOT NULL) + (dynamometer_feed_drive_joules IS NOT NULL) +
        (calibrated_joules IS NOT NULL) + (calibrated_spindle_joules IS NOT NULL) +
        (calibrated_feed_drive_joules IS NOT NULL) + (measured_power_joules IS NOT NULL) +
        (measured_power_spindle_joules IS NOT NULL) + (measured_power_feed_drive_joules IS NOT NULL) +
        (measured_power_idle_watts IS NOT NULL) + (rated_power_joules IS NOT NULL) +
        (rated_power_spindle_joules IS NOT NULL) + (rated_power_feed_drive_joules IS NOT NULL) +
        (max_depth_mm IS NOT NULL) + (max_spindle_load_percent IS NOT NULL) +
        (max_spindle_load_depth_mm IS NOT NULL) + (max_spindle_load_time_ms IS NOT NULL) +
        (max_feed_drive_load_percent IS NOT NULL) + (max_feed_drive_load_depth_mm IS NOT NULL) +
        (max_feed_drive_load_time_ms IS NOT NULL) + (max_spindle_power_watts IS NOT NULL) +
        (max_spindle_power_depth_mm IS NOT NULL) + (max_spindle_power_time_ms IS NOT NULL) +
        (max_thrust_newtons IS NOT NULL) + (max_thrust_depth_mm IS NOT NULL) +
        (max_thrust_time_ms IS NOT NULL) + (max_torque_newton_metres IS NOT NULL) +
        (max_torque_depth_mm IS NOT NULL) + (max_torque_time_ms IS NOT NULL) +
        (mean_spindle_load_percent IS NOT NULL) + (mean_feed_drive_load_percent IS NOT NULL) +
        (mean_override_percent IS NOT NULL) + (operator_override_percent IS NOT NULL) +
        (median_spindle_speed_rpm IS NOT NULL) + (spindle_load_fall_depth_mm IS NOT NULL) +
        (reported_energy_joules IS NOT NULL) + (reported_duration_ms IS NOT NULL) +
        (reported_max_depth_mm IS NOT NULL) + (reported_max_spindle_load_percent IS NOT NULL) +
        (reported_max_feed_drive_load_percent IS NOT NULL) +
        (reported_mean_spindle_load_percent IS NOT NULL) +
        (reported_mean_feed_drive_load_percent IS NOT NULL) +
        (reported_operator_override_percent IS NOT NULL)),
    CONSTRAINT cycles_profile_whole CHECK ((profile_id IS NULL) = (profile_version IS NULL)),
    PRIMARY KEY (machine_id, cycle_id)
) STRICT;

INSERT INTO cycle_rows (
    machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, seq, content_hash, process, strategy,
    law_version, profile_id, profile_version, recommendation_id, outcome, summary_version, sample_count, coverage,
    energy_scale, flags, quantities, spindle_speed_rpm, duration_ms, dynamometer_joules, dynamometer_spindle_joules,
    dynamometer_feed_drive_joules, calibrated_joules, calibrated_spindle_joules, calibrated_feed_drive_joules,
    measured_power_joules, measured_power_spindle_joules, measured_power_feed_drive_joules, measured_power_idle_watts,
    rated_power_joules, rated_power_spindle_joules, rated_power_feed_drive_joules, max_depth_mm,
    max_spindle_load_percent, max_spindle_load_depth_mm, max_spindle_load_time_ms, max_feed_drive_load_percent,
    max_feed_drive_load_depth_mm, max_feed_drive_load_time_ms, max_spindle_power_watts, max_spindle_power_depth_mm,
    max_spindle_power_time_ms, max_thrust_newtons, max_thrust_depth_mm, max_thrust_time_ms, max_torque_newton_metres,
    max_torque_depth_mm, max_torque_time_ms, mean_spindle_load_percent, mean_feed_drive_load_percent,
    mean_override_percent, operator_override_percent, median_spindle_speed_rpm, spindle_load_fall_depth_mm,
    reported_energy_joules, reported_duration_ms, reported_max_depth_mm, reported_max_spindle_load_percent,
    reported_max_feed_drive_load_percent, reported_mean_spindle_load_percent, reported_mean_feed_drive_load_percent,
    reported_operator_override_percent, depth_digest
)
SELECT
    machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, seq, content_hash, process, strategy,
    law_version, profile_id, profile_version, recommendation_id, outcome, summary_version, sample_count, coverage,
    energy_scale, flags, quantities, spindle_speed_rpm, duration_ms, dynamometer_joules, dynamometer_spindle_joules,
    dynamometer_feed_drive_joules, calibrated_joules, calibrated_spindle_joules, calibrated_feed_drive_joules,
    measured_power_joules, measured_power_spindle_joules, measured_power_feed_drive_joules, measured_power_idle_watts,
    rated_power_joules, rated_power_spindle_joules, rated_power_feed_drive_joules, max_depth_mm,
    max_spindle_load_percent, max_spindle_load_depth_mm, max_spindle_load_time_ms, max_feed_drive_load_percent,
    max_feed_drive_load_depth_mm, max_feed_drive_load_time_ms, max_spindle_power_watts, max_spindle_power_depth_mm,
    max_spindle_power_time_ms, max_thrust_newtons, max_thrust_depth_mm, max_thrust_time_ms, max_torque_newton_metres,
    max_torque_depth_mm, max_torque_time_ms, mean_spindle_load_percent, mean_feed_drive_load_percent,
    mean_override_percent, operator_override_percent, median_spindle_speed_rpm, spindle_load_fall_depth_mm,
    reported_energy_joules, reported_duration_ms, reported_max_depth_mm, reported_max_spindle_load_percent,
    reported_max_feed_drive_load_percent, reported_mean_spindle_load_percent, reported_mean_feed_drive_load_percent,
    reported_operator_override_percent, depth_digest
FROM cycles;

DROP TABLE cycles;
ALTER TABLE cycle_rows RENAME TO cycles;

-- The order of the fold; cycles without a count of their own come before those with one.
CREATE INDEX cycles_by_tool ON cycles (tool_id, started_at_us, machine_id, COALESCE(seq, -1), cycle_id);
CREATE INDEX cycles_by_operation ON cycles (operation_id, started_at_us, machine_id, cycle_id);
CREATE INDEX cycles_by_machine ON cycles (machine_id, started_at_us, cycle_id);
CREATE INDEX cycles_by_time ON cycles (started_at_us, machine_id, cycle_id);
CREATE INDEX cycles_by_profile ON cycles (profile_id, profile_version, started_at_us) WHERE profile_id IS NOT NULL;
