-- A statement that inserts reads every check of its table anew: those of a cycle's 65 columns took a server more than all else that
-- it did with a cycle that came alone, most of it for numerics that are made floats. Columns of one range are held to it together
-- (of a NaN GREATEST makes a NaN, which is beyond any number), and ranges are floats. All rows were held to the same before: nothing
-- is looked through.

ALTER TABLE cycles
    DROP CONSTRAINT cycles_coverage_range,
    DROP CONSTRAINT cycles_spindle_speed_rpm_range,
    DROP CONSTRAINT cycles_duration_ms_range,
    DROP CONSTRAINT cycles_max_spindle_load_time_ms_range,
    DROP CONSTRAINT cycles_max_feed_drive_load_time_ms_range,
    DROP CONSTRAINT cycles_max_spindle_power_time_ms_range,
    DROP CONSTRAINT cycles_max_thrust_time_ms_range,
    DROP CONSTRAINT cycles_max_torque_time_ms_range,
    DROP CONSTRAINT cycles_dynamometer_joules_range,
    DROP CONSTRAINT cycles_dynamometer_spindle_joules_range,
    DROP CONSTRAINT cycles_dynamometer_feed_drive_joules_range,
    DROP CONSTRAINT cycles_calibrated_joules_range,
    DROP CONSTRAINT cycles_calibrated_spindle_joules_range,
    DROP CONSTRAINT cycles_calibrated_feed_drive_joules_range,
    DROP CONSTRAINT cycles_measured_power_joules_range,
    DROP CONSTRAINT cycles_measured_power_spindle_joules_range,
    DROP CONSTRAINT cycles_measured_power_feed_drive_joules_range,
    DROP CONSTRAINT cycles_rated_power_joules_range,
    DROP CONSTRAINT cycles_rated_power_spindle_joules_range,
    DROP CONSTRAINT cycles_rated_power_feed_drive_joules_range,
    DROP CONSTRAINT cycles_measured_power_idle_watts_range,
    DROP CONSTRAINT cycles_max_spindle_power_watts_range,
    DROP CONSTRAINT cycles_max_thrust_newtons_range,
    DROP CONSTRAINT cycles_max_depth_mm_range,
    DROP CONSTRAINT cycles_max_spindle_load_depth_mm_range,
    DROP CONSTRAINT cycles_max_feed_drive_load_depth_mm_range,
    DROP CONSTRAINT cycles_max_spindle_power_depth_mm_range,
    DROP CONSTRAINT cycles_max_thrust_depth_mm_range,
    DROP CONSTRAINT cycles_max_torque_depth_mm_range,
    DROP CONSTRAINT cycles_spindle_load_fall_depth_mm_range,
    DROP CONSTRAINT cycles_reported_max_depth_mm_range,
    DROP CONSTRAINT cycles_max_spindle_load_percent_range,
    DROP CONSTRAINT cycles_max_feed_drive_load_percent_range,
    DROP CONSTRAINT cycles_mean_spindle_load_percent_range,
    DROP CONSTRAINT cycles_mean_feed_drive_load_percent_range,
    DROP CONSTRAINT cycles_reported_max_spindle_load_percent_range,
    DROP CONSTRAINT cycles_reported_max_feed_drive_load_percent_range,
    DROP CONSTRAINT cycles_reported_mean_spindle_load_percent_range,
    DROP CONSTRAINT cycles_reported_mean_feed_drive_load_percent_range,
    DROP CONSTRAINT cycles_max_torque_newton_metres_range,
    DROP CONSTRAINT cycles_median_spindle_speed_rpm_range,
    DROP CONSTRAINT cycles_mean_override_percent_range,
    DROP CONSTRAINT cycles_operator_override_percent_range,
    DROP CONSTRAINT cycles_reported_operator_override_percent_range,
    DROP CONSTRAINT cycles_reported_energy_joules_range,
    DROP CONSTRAINT cycles_reported_duration_ms_range;
ALTER TABLE cycles ADD CONSTRAINT cycles_coverage_range CHECK (
    coverage >= '0'::FLOAT8 AND coverage <= '1'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_spindle_speed_rpm_range CHECK (
    spindle_speed_rpm >= '0'::FLOAT8 AND spindle_speed_rpm <= '1000000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_times_range CHECK (
    LEAST(duration_ms, max_spindle_load_time_ms, max_feed_drive_load_time_ms, max_spindle_power_time_ms,
    max_thrust_time_ms, max_torque_time_ms) >= '0'::FLOAT8 AND GREATEST(duration_ms, max_spindle_load_time_ms,
    max_feed_drive_load_time_ms, max_spindle_power_time_ms, max_thrust_time_ms, max_torque_time_ms) <= '1e9'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_joules_range CHECK (
    LEAST(dynamometer_joules, dynamometer_spindle_joules, dynamometer_feed_drive_joules, calibrated_joules,
    calibrated_spindle_joules, calibrated_feed_drive_joules, measured_power_joules, measured_power_spindle_joules,
    measured_power_feed_drive_joules, rated_power_joules, rated_power_spindle_joules, rated_power_feed_drive_joules)
    >= '-1e18'::FLOAT8 AND GREATEST(dynamometer_joules, dynamometer_spindle_joules, dynamometer_feed_drive_joules,
    calibrated_joules, calibrated_spindle_joules, calibrated_feed_drive_joules, measured_power_joules,
    measured_power_spindle_joules, measured_power_feed_drive_joules, rated_power_joules, rated_power_spindle_joules,
    rated_power_feed_drive_joules) <= '1e18'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_watts_and_newtons_range CHECK (
    LEAST(measured_power_idle_watts, max_spindle_power_watts, max_thrust_newtons) >= '-10000000'::FLOAT8 AND
    GREATEST(measured_power_idle_watts, max_spindle_power_watts, max_thrust_newtons) <= '10000000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_depths_range CHECK (
    LEAST(max_depth_mm, max_spindle_load_depth_mm, max_feed_drive_load_depth_mm, max_spindle_power_depth_mm,
    max_thrust_depth_mm, max_torque_depth_mm, spindle_load_fall_depth_mm, reported_max_depth_mm) >= '-100000'::FLOAT8
    AND GREATEST(max_depth_mm, max_spindle_load_depth_mm, max_feed_drive_load_depth_mm, max_spindle_power_depth_mm,
    max_thrust_depth_mm, max_torque_depth_mm, spindle_load_fall_depth_mm, reported_max_depth_mm) <= '100000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_percents_range CHECK (
    LEAST(max_spindle_load_percent, max_feed_drive_load_percent, mean_spindle_load_percent,
    mean_feed_drive_load_percent, reported_max_spindle_load_percent, reported_max_feed_drive_load_percent,
    reported_mean_spindle_load_percent, reported_mean_feed_drive_load_percent) >= '-10000'::FLOAT8 AND
    GREATEST(max_spindle_load_percent, max_feed_drive_load_percent, mean_spindle_load_percent,
    mean_feed_drive_load_percent, reported_max_spindle_load_percent, reported_max_feed_drive_load_percent,
    reported_mean_spindle_load_percent, reported_mean_feed_drive_load_percent) <= '10000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_torque_and_speed_range CHECK (
    LEAST(max_torque_newton_metres, median_spindle_speed_rpm) >= '-1000000'::FLOAT8 AND
    GREATEST(max_torque_newton_metres, median_spindle_speed_rpm) <= '1000000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_overrides_range CHECK (
    LEAST(mean_override_percent, operator_override_percent, reported_operator_override_percent) >= '0'::FLOAT8 AND
    GREATEST(mean_override_percent, operator_override_percent, reported_operator_override_percent) <= '1000'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_reported_energy_joules_range CHECK (
    reported_energy_joules >= '-1e12'::FLOAT8 AND reported_energy_joules <= '1e12'::FLOAT8) NOT VALID;
ALTER TABLE cycles ADD CONSTRAINT cycles_reported_duration_ms_range CHECK (
    reported_duration_ms >= '0'::FLOAT8 AND reported_duration_ms <= '86400000'::FLOAT8) NOT VALID;
ALTER TABLE cycles
    DROP CONSTRAINT cycles_machine_id_length,
    DROP CONSTRAINT cycles_cycle_id_length,
    DROP CONSTRAINT cycles_tool_id_length,
    DROP CONSTRAINT cycles_operation_id_length,
    DROP CONSTRAINT cycles_profile_id_length,
    DROP CONSTRAINT cycles_recommendation_id_length;
ALTER TABLE cycles ADD CONSTRAINT cycles_ids_length CHECK (
    LEAST(length(machine_id), length(cycle_id), length(tool_id), length(operation_id), length(profile_id),
    length(recommendation_id)) >= 1 AND GREATEST(length(machine_id), length(cycle_id), length(tool_id),
    length(operation_id), length(profile_id), length(recommendation_id)) <= 128) NOT VALID;

ALTER TABLE recommendations
    DROP CONSTRAINT recommendations_level_as_run_range,
    DROP CONSTRAINT recommendations_level_lowest_range,
    DROP CONSTRAINT recommendations_level_highest_range,
    DROP CONSTRAINT recommendations_level_value_range,
    DROP CONSTRAINT recommendations_level_sd_range,
    DROP CONSTRAINT recommendations_remaining_cycles_range,
    DROP CONSTRAINT recommendations_remaining_low_range,
    DROP CONSTRAINT recommendations_remaining_high_range,
    DROP CONSTRAINT recommendations_data_age_ms_range,
    DROP CONSTRAINT recommendations_recommendation_id_length,
    DROP CONSTRAINT recommendations_machine_id_length,
    DROP CONSTRAINT recommendations_operation_id_length,
    DROP CONSTRAINT recommendations_tool_id_length;
ALTER TABLE recommendations ADD CONSTRAINT recommendations_levels_range CHECK (
    LEAST(level_as_run, level_lowest, level_highest, level_value) >= '-1e6'::FLOAT8 AND GREATEST(level_as_run,
    level_lowest, level_highest, level_value) <= '1e6'::FLOAT8) NOT VALID;
ALTER TABLE recommendations ADD CONSTRAINT recommendations_level_sd_range CHECK (
    level_sd >= '0'::FLOAT8 AND level_sd <= '1e6'::FLOAT8) NOT VALID;
ALTER TABLE recommendations ADD CONSTRAINT recommendations_counts_range CHECK (
    LEAST(remaining_cycles, remaining_low, remaining_high, data_age_ms) >= 0) NOT VALID;
ALTER TABLE recommendations ADD CONSTRAINT recommendations_ids_length CHECK (
    LEAST(length(recommendation_id), length(machine_id), length(operation_id), length(tool_id)) >= 1 AND
    GREATEST(length(recommendation_id), length(machine_id), length(operation_id), length(tool_id)) <= 128) NOT VALID;
