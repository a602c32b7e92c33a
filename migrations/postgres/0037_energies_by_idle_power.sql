-- What was done about idle power in the energy of a cycle, in the words of the API: energies with it and without it are not compared, as those
-- of different bases are not. Everything else of the view is as it was.
CREATE OR REPLACE VIEW grafana_cycles AS
SELECT machine_id,
       cycle_id,
       tool_id,
       operation_id,
       to_timestamp(started_at_us / 1e6) AS started_at,
       started_at_us,
       to_timestamp(received_at_us / 1e6) AS received_at,
       received_at_us,
       process,
       strategy,
       outcome,
       COALESCE(duration_ms, reported_duration_ms) / 1e3 AS duration_seconds,
       COALESCE(dynamometer_joules, calibrated_joules, measured_power_joules, rated_power_joules,
                reported_energy_joules) AS energy_joules,
       CASE WHEN dynamometer_joules IS NOT NULL THEN 'dynamometer'
            WHEN calibrated_joules IS NOT NULL THEN 'calibrated'
            WHEN measured_power_joules IS NOT NULL THEN 'measured_power'
            WHEN rated_power_joules IS NOT NULL THEN 'rated_power'
            WHEN reported_energy_joules IS NOT NULL THEN 'reported' END AS energy_basis,
       max_spindle_load_percent / 100.0 AS max_spindle_load_ratio,
       max_feed_drive_load_percent / 100.0 AS max_feed_drive_load_ratio,
       mean_override_percent / 100.0 AS mean_override_ratio,
       coverage AS coverage_ratio,
       profile_id,
       profile_version,
       recommendation_id,
       flags,
       CASE WHEN COALESCE(dynamometer_joules, calibrated_joules) IS NOT NULL THEN 'not_applicable'
            WHEN measured_power_joules IS NOT NULL AND measured_power_idle_watts IS NOT NULL THEN 'subtracted'
            WHEN COALESCE(measured_power_joules, rated_power_joules, reported_energy_joules) IS NOT NULL
                THEN 'included' END AS energy_idle_power
FROM cycles;
