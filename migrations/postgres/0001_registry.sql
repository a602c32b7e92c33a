-- What people register: machines with their fitted lines, tools with their events, operations.
-- Times are microseconds since 1970 UTC. No NULL stands for a number that could not be read, and ranges are checked
-- here too, so that neither NaN nor an infinity can be stored by any client.

CREATE TABLE machines (
    machine_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT machines_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    name TEXT NOT NULL CONSTRAINT machines_name_length CHECK (length(name) BETWEEN 0 AND 1000),
    control TEXT NOT NULL CONSTRAINT machines_control_length CHECK (length(control) BETWEEN 0 AND 1000),
    ipo_period_ms DOUBLE PRECISION NOT NULL
        CONSTRAINT machines_ipo_period_ms_range CHECK (ipo_period_ms BETWEEN 0.01 AND 10000.0),
    spindle_reference TEXT NOT NULL
        CONSTRAINT machines_spindle_reference_word
            CHECK (spindle_reference IN ('unknown', 'rated_power', 'continuous_rating', 'rated_torque', 'maximum_current')),
    spindle_rated_power_watts DOUBLE PRECISION
        CONSTRAINT machines_spindle_rated_power_watts_range CHECK (spindle_rated_power_watts BETWEEN 1.0 AND 10000000.0),
    spindle_base_speed_rpm DOUBLE PRECISION
        CONSTRAINT machines_spindle_base_speed_rpm_range CHECK (spindle_base_speed_rpm BETWEEN 0.0 AND 1000000.0),
    feed_drive_reference TEXT NOT NULL
        CONSTRAINT machines_feed_drive_reference_word
            CHECK (feed_drive_reference IN ('unknown', 'rated_power', 'continuous_rating', 'rated_torque', 'maximum_current')),
    feed_drive_rated_thrust_newtons DOUBLE PRECISION
        CONSTRAINT machines_feed_drive_rated_thrust_newtons_range CHECK (feed_drive_rated_thrust_newtons BETWEEN 1.0 AND 10000000.0),
    feed_min_mm_min DOUBLE PRECISION NOT NULL
        CONSTRAINT machines_feed_min_mm_min_range CHECK (feed_min_mm_min BETWEEN 0.0 AND 1000000.0),
    feed_max_mm_min DOUBLE PRECISION NOT NULL
        CONSTRAINT machines_feed_max_mm_min_range CHECK (feed_max_mm_min BETWEEN 0.0 AND 1000000.0),
    override_min_percent DOUBLE PRECISION NOT NULL
        CONSTRAINT machines_override_min_percent_range CHECK (override_min_percent BETWEEN 0.0 AND 100.0),
    override_max_percent DOUBLE PRECISION NOT NULL
        CONSTRAINT machines_override_max_percent_range CHECK (override_max_percent BETWEEN 100.0 AND 1000.0),
    version BIGINT NOT NULL CONSTRAINT machines_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us BIGINT NOT NULL,
    CONSTRAINT machines_feed_range CHECK (feed_min_mm_min < feed_max_mm_min),
    CONSTRAINT machines_override_above_zero CHECK (override_min_percent > 0.0)
);

-- Fitted lines, a row per version, never changed.
CREATE TABLE calibrations (
    machine_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT calibrations_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    version BIGINT NOT NULL CONSTRAINT calibrations_version_range CHECK (version BETWEEN 1 AND 4294967295),
    fitted_at_us BIGINT NOT NULL,
    thrust_slope DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_slope_range CHECK (thrust_slope BETWEEN -1000000.0 AND 1000000.0),
    thrust_intercept DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_intercept_range CHECK (thrust_intercept BETWEEN -10000000.0 AND 10000000.0),
    thrust_min_percent DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_min_percent_range CHECK (thrust_min_percent BETWEEN -10000.0 AND 10000.0),
    thrust_max_percent DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_max_percent_range CHECK (thrust_max_percent BETWEEN -10000.0 AND 10000.0),
    thrust_r_squared DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_r_squared_range CHECK (thrust_r_squared BETWEEN 0.0 AND 1.0),
    thrust_residual_spread DOUBLE PRECISION
        CONSTRAINT calibrations_thrust_residual_spread_range CHECK (thrust_residual_spread BETWEEN 0.0 AND 10000000.0),
    torque_slope DOUBLE PRECISION
        CONSTRAINT calibrations_torque_slope_range CHECK (torque_slope BETWEEN -1000000.0 AND 1000000.0),
    torque_intercept DOUBLE PRECISION
        CONSTRAINT calibrations_torque_intercept_range CHECK (torque_intercept BETWEEN -10000000.0 AND 10000000.0),
    torque_min_percent DOUBLE PRECISION
        CONSTRAINT calibrations_torque_min_percent_range CHECK (torque_min_percent BETWEEN -10000.0 AND 10000.0),
    torque_max_percent DOUBLE PRECISION
        CONSTRAINT calibrations_torque_max_percent_range CHECK (torque_max_percent BETWEEN -10000.0 AND 10000.0),
    torque_r_squared DOUBLE PRECISION
        CONSTRAINT calibrations_torque_r_squared_range CHECK (torque_r_squared BETWEEN 0.0 AND 1.0),
    torque_residual_spread DOUBLE PRECISION
        CONSTRAINT calibrations_torque_residual_spread_range CHECK (torque_residual_spread BETWEEN 0.0 AND 10000000.0),
    -- Whole or absent: also what keeps a NaN that became NULL out.
    CONSTRAINT calibrations_thrust_whole CHECK (num_nonnulls(thrust_slope, thrust_intercept, thrust_min_percent, thrust_max_percent, thrust_r_squared, thrust_residual_spread) IN (0, 6)),
    -- Whole or absent: also what keeps a NaN that became NULL out.
    CONSTRAINT calibrations_torque_whole CHECK (num_nonnulls(torque_slope, torque_intercept, torque_min_percent, torque_max_percent, torque_r_squared, torque_residual_spread) IN (0, 6)),
    PRIMARY KEY (machine_id, version)
);

CREATE TABLE tools (
    tool_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT tools_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    name TEXT NOT NULL CONSTRAINT tools_name_length CHECK (length(name) BETWEEN 0 AND 1000),
    serial TEXT CONSTRAINT tools_serial_length CHECK (length(serial) BETWEEN 0 AND 1000),
    tool_type TEXT NOT NULL CONSTRAINT tools_tool_type_length CHECK (length(tool_type) BETWEEN 0 AND 1000),
    diameter_mm DOUBLE PRECISION
        CONSTRAINT tools_diameter_mm_range CHECK (diameter_mm BETWEEN 0.01 AND 10000.0),
    version BIGINT NOT NULL CONSTRAINT tools_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us BIGINT NOT NULL
);

-- What happened to a tool: added, never changed.
CREATE TABLE tool_events (
    event_id BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    tool_id TEXT COLLATE "C" NOT NULL
        CONSTRAINT tool_events_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128),
    kind TEXT NOT NULL
        CONSTRAINT tool_events_kind_word
            CHECK (kind IN ('mounted_new', 'mounted_used', 'changed', 'reground', 'reset', 'conditions_confirmed')),
    at_us BIGINT NOT NULL,
    first_machine_id TEXT COLLATE "C"
        CONSTRAINT tool_events_first_machine_id_length CHECK (length(first_machine_id) BETWEEN 1 AND 128),
    first_cycle_id TEXT COLLATE "C"
        CONSTRAINT tool_events_first_cycle_id_length CHECK (length(first_cycle_id) BETWEEN 1 AND 128),
    reason TEXT CONSTRAINT tool_events_reason_length CHECK (length(reason) BETWEEN 0 AND 10000),
    actor TEXT NOT NULL CONSTRAINT tool_events_actor_length CHECK (length(actor) BETWEEN 0 AND 1000),
    recorded_at_us BIGINT NOT NULL,
    CONSTRAINT tool_events_first_cycle_whole CHECK ((first_machine_id IS NULL) = (first_cycle_id IS NULL))
);

CREATE INDEX tool_events_by_tool ON tool_events (tool_id, event_id);

CREATE TABLE operations (
    operation_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT operations_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    name TEXT NOT NULL CONSTRAINT operations_name_length CHECK (length(name) BETWEEN 0 AND 1000),
    process TEXT NOT NULL
        CONSTRAINT operations_process_word
            CHECK (process IN ('friction', 'drilling', 'plunge', 'turning', 'vibratory', 'milling')),
    program TEXT CONSTRAINT operations_program_length CHECK (length(program) BETWEEN 0 AND 1000),
    feature TEXT CONSTRAINT operations_feature_length CHECK (length(feature) BETWEEN 0 AND 1000),
    work_material TEXT
        CONSTRAINT operations_work_material_length CHECK (length(work_material) BETWEEN 0 AND 1000),
    thickness_mm DOUBLE PRECISION
        CONSTRAINT operations_thickness_mm_range CHECK (thickness_mm BETWEEN 0.001 AND 100000.0),
    depth_mm DOUBLE PRECISION
        CONSTRAINT operations_depth_mm_range CHECK (depth_mm BETWEEN 0.001 AND 100000.0),
    spindle_speed_rpm DOUBLE PRECISION
        CONSTRAINT operations_spindle_speed_rpm_range CHECK (spindle_speed_rpm BETWEEN 0.0 AND 1000000.0),
    programmed_feed_mm_min DOUBLE PRECISION
        CONSTRAINT operations_programmed_feed_mm_min_range CHECK (programmed_feed_mm_min BETWEEN 0.0 AND 1000000.0),
    spindle_load_set_percent DOUBLE PRECISION
        CONSTRAINT operations_spindle_load_set_percent_range CHECK (spindle_load_set_percent BETWEEN 0.1 AND 400.0),
    feed_drive_load_set_percent DOUBLE PRECISION
        CONSTRAINT operations_feed_drive_load_set_percent_range CHECK (feed_drive_load_set_percent BETWEEN 0.1 AND 400.0),
    baseline_cycles BIGINT NOT NULL
        CONSTRAINT operations_baseline_cycles_range CHECK (baseline_cycles BETWEEN 3 AND 500),
    window_cycles BIGINT NOT NULL
        CONSTRAINT operations_window_cycles_range CHECK (window_cycles BETWEEN 3 AND 500),
    version BIGINT NOT NULL
        CONSTRAINT operations_version_range CHECK (version BETWEEN 1 AND 9007199254740991),
    updated_at_us BIGINT NOT NULL
);
