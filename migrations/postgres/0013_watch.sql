-- When each machine was last heard of, and what Grafana reads.

-- By the server's clock, and apart from the cycles: replicas note it once in a while, not with every cycle, and a
-- machine whose own clock is wrong is not silent for it.
CREATE TABLE machine_contacts (
    machine_id TEXT COLLATE "C" PRIMARY KEY NOT NULL
        CONSTRAINT machine_contacts_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    last_cycle_at_us BIGINT NOT NULL
);

INSERT INTO machine_contacts (machine_id, last_cycle_at_us)
SELECT machine_id, MAX(received_at_us) FROM cycles GROUP BY machine_id;

-- Views for dashboards: seconds, joules and ratios, times as Grafana wants them. Their columns only ever grow. A
-- panel restricts a view by its *_us column, which has the index.

CREATE VIEW grafana_machines AS
SELECT m.machine_id,
       m.name,
       m.control,
       to_timestamp(c.last_cycle_at_us / 1e6) AS last_cycle_at,
       c.last_cycle_at_us,
       (SELECT COUNT(*) FROM alarms a WHERE a.machine_id = m.machine_id AND a.cleared_at_us IS NULL) AS open_alarms
FROM machines m
LEFT JOIN machine_contacts c ON c.machine_id = m.machine_id;

-- The best energy of a cycle, in the order in which the service chooses it; NULL where nothing tells it.
CREATE VIEW grafana_cycles AS
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
       flags
FROM cycles;

CREATE VIEW grafana_tool_events AS
SELECT event_id, tool_id, kind, to_timestamp(at_us / 1e6) AS at, at_us, reason
FROM tool_events;

CREATE VIEW grafana_alarms AS
SELECT alarm_id, kind, machine_id, tool_id, message,
       to_timestamp(raised_at_us / 1e6) AS raised_at, raised_at_us,
       to_timestamp(cleared_at_us / 1e6) AS cleared_at, cleared_at_us,
       to_timestamp(acknowledged_at_us / 1e6) AS acknowledged_at
FROM alarms;

-- Without the bodies: a dashboard says that something waits, and the service shows what.
CREATE VIEW grafana_quarantine AS
SELECT quarantine_id, machine_id, cycle_id, code, to_timestamp(received_at_us / 1e6) AS received_at, received_at_us,
       size AS size_bytes, settled_at_us IS NOT NULL AS is_settled
FROM quarantine;

-- Which tools there are, with how many cycles each ran and when it last did.
CREATE VIEW grafana_tools AS
SELECT t.tool_id, t.name, t.tool_type, t.serial, w.cycles_folded, w.last_machine_id
FROM tools t
LEFT JOIN (
    SELECT tool_id, SUM(folded)::BIGINT AS cycles_folded,
           (array_agg(machine_id ORDER BY updated_at_us DESC))[1] AS last_machine_id
    FROM tool_wear GROUP BY tool_id
) w ON w.tool_id = t.tool_id;
