-- A cycle's row is shorter. What a control reports and what it samples are decimals of three places: they are stored as whole
-- thousandths, which SQLite writes in as many bytes as they need, where a number is exactly that, and as they are otherwise. An energy
-- that is the sum of its parts, to the bit, is not stored beside them. Columns that are seldom used stand last: where
-- nothing follows, nothing is written of them. All of them are read under the names that they had: of type ANY, since what SQLite sorts by the way comes
-- back as a whole number where it is one and its column is REAL.

CREATE TABLE cycle_rows (
    outcome TEXT GENERATED ALWAYS AS (CASE is_aborted WHEN 1 THEN 'aborted' ELSE 'completed' END) VIRTUAL,
    dynamometer_joules ANY GENERATED ALWAYS AS (CASE typeof(dynamometer_joules_stored) WHEN 'integer' THEN dynamometer_spindle_joules + COALESCE(dynamometer_feed_drive_joules, 0.0) ELSE dynamometer_joules_stored END) VIRTUAL
        CONSTRAINT cycles_dynamometer_joules_range CHECK (dynamometer_joules BETWEEN -1e18 AND 1e18),
    calibrated_joules ANY GENERATED ALWAYS AS (CASE typeof(calibrated_joules_stored) WHEN 'integer' THEN calibrated_spindle_joules + COALESCE(calibrated_feed_drive_joules, 0.0) ELSE calibrated_joules_stored END) VIRTUAL
        CONSTRAINT cycles_calibrated_joules_range CHECK (calibrated_joules BETWEEN -1e18 AND 1e18),
    measured_power_joules ANY GENERATED ALWAYS AS (CASE typeof(measured_power_joules_stored) WHEN 'integer' THEN measured_power_spindle_joules + COALESCE(measured_power_feed_drive_joules, 0.0) ELSE measured_power_joules_stored END) VIRTUAL
        CONSTRAINT cycles_measured_power_joules_range CHECK (measured_power_joules BETWEEN -1e18 AND 1e18),
    rated_power_joules ANY GENERATED ALWAYS AS (CASE typeof(rated_power_joules_stored) WHEN 'integer' THEN rated_power_spindle_joules + COALESCE(rated_power_feed_drive_joules, 0.0) ELSE rated_power_joules_stored END) VIRTUAL
        CONSTRAINT cycles_rated_power_joules_range CHECK (rated_power_joules BETWEEN -1e18 AND 1e18),
    max_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_depth_mm_stored) WHEN 'integer' THEN max_depth_mm_stored / 1000.0 ELSE max_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_depth_mm_range CHECK (max_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_load_percent ANY GENERATED ALWAYS AS (CASE typeof(max_spindle_load_percent_stored) WHEN 'integer' THEN max_spindle_load_percent_stored / 1000.0 ELSE max_spindle_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_max_spindle_load_percent_range CHECK (max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    max_spindle_load_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_spindle_load_depth_mm_stored) WHEN 'integer' THEN max_spindle_load_depth_mm_stored / 1000.0 ELSE max_spindle_load_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_spindle_load_depth_mm_range CHECK (max_spindle_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_feed_drive_load_percent ANY GENERATED ALWAYS AS (CASE typeof(max_feed_drive_load_percent_stored) WHEN 'integer' THEN max_feed_drive_load_percent_stored / 1000.0 ELSE max_feed_drive_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_max_feed_drive_load_percent_range CHECK (max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    max_feed_drive_load_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_feed_drive_load_depth_mm_stored) WHEN 'integer' THEN max_feed_drive_load_depth_mm_stored / 1000.0 ELSE max_feed_drive_load_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_feed_drive_load_depth_mm_range CHECK (max_feed_drive_load_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_spindle_power_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_spindle_power_depth_mm_stored) WHEN 'integer' THEN max_spindle_power_depth_mm_stored / 1000.0 ELSE max_spindle_power_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_spindle_power_depth_mm_range CHECK (max_spindle_power_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_thrust_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_thrust_depth_mm_stored) WHEN 'integer' THEN max_thrust_depth_mm_stored / 1000.0 ELSE max_thrust_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_thrust_depth_mm_range CHECK (max_thrust_depth_mm BETWEEN -100000.0 AND 100000.0),
    max_torque_newton_metres ANY GENERATED ALWAYS AS (CASE typeof(max_torque_newton_metres_stored) WHEN 'integer' THEN max_torque_newton_metres_stored / 1000.0 ELSE max_torque_newton_metres_stored END) VIRTUAL
        CONSTRAINT cycles_max_torque_newton_metres_range CHECK (max_torque_newton_metres BETWEEN -1000000.0 AND 1000000.0),
    max_torque_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(max_torque_depth_mm_stored) WHEN 'integer' THEN max_torque_depth_mm_stored / 1000.0 ELSE max_torque_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_max_torque_depth_mm_range CHECK (max_torque_depth_mm BETWEEN -100000.0 AND 100000.0),
    spindle_load_fall_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(spindle_load_fall_depth_mm_stored) WHEN 'integer' THEN spindle_load_fall_depth_mm_stored / 1000.0 ELSE spindle_load_fall_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_spindle_load_fall_depth_mm_range CHECK (spindle_load_fall_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_energy_joules ANY GENERATED ALWAYS AS (CASE typeof(reported_energy_joules_stored) WHEN 'integer' THEN reported_energy_joules_stored / 1000.0 ELSE reported_energy_joules_stored END) VIRTUAL
        CONSTRAINT cycles_reported_energy_joules_range CHECK (reported_energy_joules BETWEEN -1e12 AND 1e12),
    reported_max_depth_mm ANY GENERATED ALWAYS AS (CASE typeof(reported_max_depth_mm_stored) WHEN 'integer' THEN reported_max_depth_mm_stored / 1000.0 ELSE reported_max_depth_mm_stored END) VIRTUAL
        CONSTRAINT cycles_reported_max_depth_mm_range CHECK (reported_max_depth_mm BETWEEN -100000.0 AND 100000.0),
    reported_max_spindle_load_percent ANY GENERATED ALWAYS AS (CASE typeof(reported_max_spindle_load_percent_stored) WHEN 'integer' THEN reported_max_spindle_load_percent_stored / 1000.0 ELSE reported_max_spindle_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_reported_max_spindle_load_percent_range CHECK (reported_max_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_max_feed_drive_load_percent ANY GENERATED ALWAYS AS (CASE typeof(reported_max_feed_drive_load_percent_stored) WHEN 'integer' THEN reported_max_feed_drive_load_percent_stored / 1000.0 ELSE reported_max_feed_drive_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_reported_max_feed_drive_load_percent_range CHECK (reported_max_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_spindle_load_percent ANY GENERATED ALWAYS AS (CASE typeof(reported_mean_spindle_load_percent_stored) WHEN 'integer' THEN reported_mean_spindle_load_percent_stored / 1000.0 ELSE reported_mean_spindle_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_reported_mean_spindle_load_percent_range CHECK (reported_mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    reported_mean_feed_drive_load_percent ANY GENERATED ALWAYS AS (CASE typeof(reported_mean_feed_drive_load_percent_stored) WHEN 'integer' THEN reported_mean_feed_drive_load_percent_stored / 1000.0 ELSE reported_mean_feed_drive_load_percent_stored END) VIRTUAL
        CONSTRAINT cycles_reported_mean_feed_drive_load_percent_range CHECK (reported_mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    machine_id TEXT NOT NULL CONSTRAINT cycles_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT NOT NULL CONSTRAINT cycles_cycle_id_length CHECK (length(cycle_id) BETWEEN 1 AND 128),
    tool_id TEXT NOT NULL CONSTRAINT cycles_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    operation_id TEXT NOT NULL
        CONSTRAINT cycles_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    started_at_us INTEGER NOT NULL,
    received_at_us INTEGER NOT NULL,
    content_hash BLOB NOT NULL CONSTRAINT cycles_content_hash_length CHECK (length(content_hash) = 32),
    is_aborted INTEGER NOT NULL CONSTRAINT cycles_outcome_word CHECK (is_aborted IN (0, 1)),
    summary_version INTEGER NOT NULL
        CONSTRAINT cycles_summary_version_range CHECK (summary_version BETWEEN 1 AND 4294967295),
    sample_count INTEGER NOT NULL
        CONSTRAINT cycles_sample_count_range CHECK (sample_count BETWEEN 0 AND 4294967295),
    coverage REAL NOT NULL CONSTRAINT cycles_coverage_range CHECK (coverage BETWEEN 0.0 AND 1.0),
    energy_scale INTEGER NOT NULL,
    flags INTEGER NOT NULL CONSTRAINT cycles_flags_range CHECK (flags BETWEEN 0 AND 4294967295),
    quantities INTEGER NOT NULL,
    seq INTEGER CONSTRAINT cycles_seq_range CHECK (seq >= 0),
    strategy TEXT CONSTRAINT cycles_strategy_word CHECK (strategy IN ('f_const', 'f_sec', 'f_lin', 'f_ac')),
    duration_ms REAL CONSTRAINT cycles_duration_ms_range CHECK (duration_ms BETWEEN 0.0 AND 1e9),
    spindle_speed_rpm REAL
        CONSTRAINT cycles_spindle_speed_rpm_range CHECK (spindle_speed_rpm BETWEEN 0.0 AND 1000000.0),
    depth_digest BLOB CONSTRAINT cycles_depth_digest_length CHECK (length(depth_digest) BETWEEN 5 AND 1282),
    max_depth_mm_stored ANY,
    max_spindle_load_percent_stored ANY,
    max_spindle_load_depth_mm_stored ANY,
    max_spindle_load_time_ms REAL
        CONSTRAINT cycles_max_spindle_load_time_ms_range CHECK (max_spindle_load_time_ms BETWEEN 0.0 AND 1e9),
    mean_spindle_load_percent REAL
        CONSTRAINT cycles_mean_spindle_load_percent_range CHECK (mean_spindle_load_percent BETWEEN -10000.0 AND 10000.0),
    rated_power_joules_stored ANY,
    rated_power_spindle_joules REAL
        CONSTRAINT cycles_rated_power_spindle_joules_range CHECK (rated_power_spindle_joules BETWEEN -1e18 AND 1e18),
    max_feed_drive_load_percent_stored ANY,
    max_feed_drive_load_depth_mm_stored ANY,
    max_feed_drive_load_time_ms REAL
        CONSTRAINT cycles_max_feed_drive_load_time_ms_range CHECK (max_feed_drive_load_time_ms BETWEEN 0.0 AND 1e9),
    mean_feed_drive_load_percent REAL
        CONSTRAINT cycles_mean_feed_drive_load_percent_range CHECK (mean_feed_drive_load_percent BETWEEN -10000.0 AND 10000.0),
    rated_power_feed_drive_joules REAL
        CONSTRAINT cycles_rated_power_feed_drive_joules_range CHECK (rated_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    mean_override_percent REAL
        CONSTRAINT cycles_mean_override_percent_range CHECK (mean_override_percent BETWEEN 0.0 AND 1000.0),
    spindle_load_fall_depth_mm_stored ANY,
    max_torque_newton_metres_stored ANY,
    max_torque_depth_mm_stored ANY,
    max_torque_time_ms REAL
        CONSTRAINT cycles_max_torque_time_ms_range CHECK (max_torque_time_ms BETWEEN 0.0 AND 1e9),
    max_thrust_newtons REAL
        CONSTRAINT cycles_max_thrust_newtons_range CHECK (max_thrust_newtons BETWEEN -10000000.0 AND 10000000.0),
    max_thrust_depth_mm_stored ANY,
    max_thrust_time_ms REAL
        CONSTRAINT cycles_max_thrust_time_ms_range CHECK (max_thrust_time_ms BETWEEN 0.0 AND 1e9),
    dynamometer_joules_stored ANY,
    dynamometer_spindle_joules REAL
        CONSTRAINT cycles_dynamometer_spindle_joules_range CHECK (dynamometer_spindle_joules BETWEEN -1e18 AND 1e18),
    dynamometer_feed_drive_joules REAL
        CONSTRAINT cycles_dynamometer_feed_drive_joules_range CHECK (dynamometer_feed_drive_joules BETWEEN -1e18 AND 1e18),
    operator_override_percent REAL
        CONSTRAINT cycles_operator_override_percent_range CHECK (operator_override_percent BETWEEN 0.0 AND 1000.0),
    median_spindle_speed_rpm REAL
        CONSTRAINT cycles_median_spindle_speed_rpm_range CHECK (median_spindle_speed_rpm BETWEEN -1000000.0 AND 1000000.0),
    recommendation_id TEXT
        CONSTRAINT cycles_recommendation_id_length CHECK (length(recommendation_id) BETWEEN 1 AND 128),
    law_version TEXT CONSTRAINT cycles_law_version_length CHECK (length(law_version) BETWEEN 1 AND 64),
    process TEXT
        CONSTRAINT cycles_process_word CHECK (process IN ('friction', 'drilling', 'plunge', 'turning', 'vibratory', 'milling')),
    profile_id TEXT CONSTRAINT cycles_profile_id_length CHECK (length(profile_id) BETWEEN 1 AND 128),
    profile_version INTEGER
        CONSTRAINT cycles_profile_version_range CHECK (profile_version BETWEEN 1 AND 4294967295),
    calibrated_joules_stored ANY,
    calibrated_spindle_joules REAL
        CONSTRAINT cycles_calibrated_spindle_joules_range CHECK (calibrated_spindle_joules BETWEEN -1e18 AND 1e18),
    calibrated_feed_drive_joules REAL
        CONSTRAINT cycles_calibrated_feed_drive_joules_range CHECK (calibrated_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_joules_stored ANY,
    measured_power_spindle_joules REAL
        CONSTRAINT cycles_measured_power_spindle_joules_range CHECK (measured_power_spindle_joules BETWEEN -1e18 AND 1e18),
    measured_power_feed_drive_joules REAL
        CONSTRAINT cycles_measured_power_feed_drive_joules_range CHECK (measured_power_feed_drive_joules BETWEEN -1e18 AND 1e18),
    measured_power_idle_watts REAL
        CONSTRAINT cycles_measured_power_idle_watts_range CHECK (measured_power_idle_watts BETWEEN -10000000.0 AND 10000000.0),
    max_spindle_power_watts REAL
        CONSTRAINT cycles_max_spindle_power_watts_range CHECK (max_spindle_power_watts BETWEEN -10000000.0 AND 10000000.0),
    max_spindle_power_depth_mm_stored ANY,
    max_spindle_power_time_ms REAL
        CONSTRAINT cycles_max_spindle_power_time_ms_range CHECK (max_spindle_power_time_ms BETWEEN 0.0 AND 1e9),
    reported_energy_joules_stored ANY,
    reported_duration_ms REAL
        CONSTRAINT cycles_reported_duration_ms_range CHECK (reported_duration_ms BETWEEN 0.0 AND 86400000.0),
    reported_max_depth_mm_stored ANY,
    reported_max_spindle_load_percent_stored ANY,
    reported_max_feed_drive_load_percent_stored ANY,
    reported_mean_spindle_load_percent_stored ANY,
    reported_mean_feed_drive_load_percent_stored ANY,
    reported_operator_override_percent REAL
        CONSTRAINT cycles_reported_operator_override_percent_range CHECK (reported_operator_override_percent BETWEEN 0.0 AND 1000.0),
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
    machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, content_hash, is_aborted,
    summary_version, sample_count, coverage, energy_scale, flags, quantities, seq, strategy, duration_ms,
    spindle_speed_rpm, depth_digest, max_depth_mm_stored, max_spindle_load_percent_stored,
    max_spindle_load_depth_mm_stored, max_spindle_load_time_ms, mean_spindle_load_percent, rated_power_joules_stored,
    rated_power_spindle_joules, max_feed_drive_load_percent_stored, max_feed_drive_load_depth_mm_stored,
    max_feed_drive_load_time_ms, mean_feed_drive_load_percent, rated_power_feed_drive_joules, mean_override_percent,
    spindle_load_fall_depth_mm_stored, max_torque_newton_metres_stored, max_torque_depth_mm_stored, max_torque_time_ms,
    max_thrust_newtons, max_thrust_depth_mm_stored, max_thrust_time_ms, dynamometer_joules_stored,
    dynamometer_spindle_joules, dynamometer_feed_drive_joules, operator_override_percent, median_spindle_speed_rpm,
    recommendation_id, law_version, process, profile_id, profile_version, calibrated_joules_stored,
    calibrated_spindle_joules, calibrated_feed_drive_joules, measured_power_joules_stored,
    measured_power_spindle_joules, measured_power_feed_drive_joules, measured_power_idle_watts, max_spindle_power_watts,
    max_spindle_power_depth_mm_stored, max_spindle_power_time_ms, reported_energy_joules_stored, reported_duration_ms,
    reported_max_depth_mm_stored, reported_max_spindle_load_percent_stored, reported_max_feed_drive_load_percent_stored,
    reported_mean_spindle_load_percent_stored, reported_mean_feed_drive_load_percent_stored,
    reported_operator_override_percent
)
SELECT
    machine_id, cycle_id, tool_id, operation_id, started_at_us, received_at_us, content_hash, outcome = 'aborted',
    summary_version, sample_count, coverage, energy_scale, flags, quantities, seq, strategy, duration_ms,
    spindle_speed_rpm, depth_digest,
    CASE WHEN abs(max_depth_mm) < 9e12 AND CAST(round(max_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_depth_mm THEN CAST(round(max_depth_mm * 1000.0) AS INTEGER) ELSE max_depth_mm END,
    CASE WHEN abs(max_spindle_load_percent) < 9e12 AND CAST(round(max_spindle_load_percent * 1000.0) AS INTEGER) / 1000.0 = max_spindle_load_percent THEN CAST(round(max_spindle_load_percent * 1000.0) AS INTEGER) ELSE max_spindle_load_percent END,
    CASE WHEN abs(max_spindle_load_depth_mm) < 9e12 AND CAST(round(max_spindle_load_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_spindle_load_depth_mm THEN CAST(round(max_spindle_load_depth_mm * 1000.0) AS INTEGER) ELSE max_spindle_load_depth_mm END,
    max_spindle_load_time_ms, mean_spindle_load_percent,
    CASE WHEN rated_power_spindle_joules + COALESCE(rated_power_feed_drive_joules, 0.0) = rated_power_joules THEN 1 ELSE rated_power_joules END,
    rated_power_spindle_joules,
    CASE WHEN abs(max_feed_drive_load_percent) < 9e12 AND CAST(round(max_feed_drive_load_percent * 1000.0) AS INTEGER) / 1000.0 = max_feed_drive_load_percent THEN CAST(round(max_feed_drive_load_percent * 1000.0) AS INTEGER) ELSE max_feed_drive_load_percent END,
    CASE WHEN abs(max_feed_drive_load_depth_mm) < 9e12 AND CAST(round(max_feed_drive_load_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_feed_drive_load_depth_mm THEN CAST(round(max_feed_drive_load_depth_mm * 1000.0) AS INTEGER) ELSE max_feed_drive_load_depth_mm END,
    max_feed_drive_load_time_ms, mean_feed_drive_load_percent, rated_power_feed_drive_joules, mean_override_percent,
    CASE WHEN abs(spindle_load_fall_depth_mm) < 9e12 AND CAST(round(spindle_load_fall_depth_mm * 1000.0) AS INTEGER) / 1000.0 = spindle_load_fall_depth_mm THEN CAST(round(spindle_load_fall_depth_mm * 1000.0) AS INTEGER) ELSE spindle_load_fall_depth_mm END,
    CASE WHEN abs(max_torque_newton_metres) < 9e12 AND CAST(round(max_torque_newton_metres * 1000.0) AS INTEGER) / 1000.0 = max_torque_newton_metres THEN CAST(round(max_torque_newton_metres * 1000.0) AS INTEGER) ELSE max_torque_newton_metres END,
    CASE WHEN abs(max_torque_depth_mm) < 9e12 AND CAST(round(max_torque_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_torque_depth_mm THEN CAST(round(max_torque_depth_mm * 1000.0) AS INTEGER) ELSE max_torque_depth_mm END,
    max_torque_time_ms, max_thrust_newtons,
    CASE WHEN abs(max_thrust_depth_mm) < 9e12 AND CAST(round(max_thrust_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_thrust_depth_mm THEN CAST(round(max_thrust_depth_mm * 1000.0) AS INTEGER) ELSE max_thrust_depth_mm END,
    max_thrust_time_ms,
    CASE WHEN dynamometer_spindle_joules + COALESCE(dynamometer_feed_drive_joules, 0.0) = dynamometer_joules THEN 1 ELSE dynamometer_joules END,
    dynamometer_spindle_joules, dynamometer_feed_drive_joules, operator_override_percent, median_spindle_speed_rpm,
    recommendation_id, law_version, process, profile_id, profile_version,
    CASE WHEN calibrated_spindle_joules + COALESCE(calibrated_feed_drive_joules, 0.0) = calibrated_joules THEN 1 ELSE calibrated_joules END,
    calibrated_spindle_joules, calibrated_feed_drive_joules,
    CASE WHEN measured_power_spindle_joules + COALESCE(measured_power_feed_drive_joules, 0.0) = measured_power_joules THEN 1 ELSE measured_power_joules END,
    measured_power_spindle_joules, measured_power_feed_drive_joules, measured_power_idle_watts, max_spindle_power_watts,
    CASE WHEN abs(max_spindle_power_depth_mm) < 9e12 AND CAST(round(max_spindle_power_depth_mm * 1000.0) AS INTEGER) / 1000.0 = max_spindle_power_depth_mm THEN CAST(round(max_spindle_power_depth_mm * 1000.0) AS INTEGER) ELSE max_spindle_power_depth_mm END,
    max_spindle_power_time_ms,
    CASE WHEN abs(reported_energy_joules) < 9e12 AND CAST(round(reported_energy_joules * 1000.0) AS INTEGER) / 1000.0 = reported_energy_joules THEN CAST(round(reported_energy_joules * 1000.0) AS INTEGER) ELSE reported_energy_joules END,
    reported_duration_ms,
    CASE WHEN abs(reported_max_depth_mm) < 9e12 AND CAST(round(reported_max_depth_mm * 1000.0) AS INTEGER) / 1000.0 = reported_max_depth_mm THEN CAST(round(reported_max_depth_mm * 1000.0) AS INTEGER) ELSE reported_max_depth_mm END,
    CASE WHEN abs(reported_max_spindle_load_percent) < 9e12 AND CAST(round(reported_max_spindle_load_percent * 1000.0) AS INTEGER) / 1000.0 = reported_max_spindle_load_percent THEN CAST(round(reported_max_spindle_load_percent * 1000.0) AS INTEGER) ELSE reported_max_spindle_load_percent END,
    CASE WHEN abs(reported_max_feed_drive_load_percent) < 9e12 AND CAST(round(reported_max_feed_drive_load_percent * 1000.0) AS INTEGER) / 1000.0 = reported_max_feed_drive_load_percent THEN CAST(round(reported_max_feed_drive_load_percent * 1000.0) AS INTEGER) ELSE reported_max_feed_drive_load_percent END,
    CASE WHEN abs(reported_mean_spindle_load_percent) < 9e12 AND CAST(round(reported_mean_spindle_load_percent * 1000.0) AS INTEGER) / 1000.0 = reported_mean_spindle_load_percent THEN CAST(round(reported_mean_spindle_load_percent * 1000.0) AS INTEGER) ELSE reported_mean_spindle_load_percent END,
    CASE WHEN abs(reported_mean_feed_drive_load_percent) < 9e12 AND CAST(round(reported_mean_feed_drive_load_percent * 1000.0) AS INTEGER) / 1000.0 = reported_mean_feed_drive_load_percent THEN CAST(round(reported_mean_feed_drive_load_percent * 1000.0) AS INTEGER) ELSE reported_mean_feed_drive_load_percent END,
    reported_operator_override_percent
FROM cycles ORDER BY rowid;

DROP TABLE cycles;
ALTER TABLE cycle_rows RENAME TO cycles;

-- The order of the fold; cycles without a count of their own come before those with one.
CREATE INDEX cycles_by_tool ON cycles (tool_id, started_at_us, machine_id, COALESCE(seq, -1));
CREATE INDEX cycles_by_operation ON cycles (operation_id, started_at_us);
CREATE INDEX cycles_by_machine ON cycles (machine_id, started_at_us);
CREATE INDEX cycles_by_time ON cycles (started_at_us);
CREATE INDEX cycles_by_profile ON cycles (profile_id, profile_version, started_at_us) WHERE profile_id IS NOT NULL;
