-- Dashboards show what holds: events that were revoked are left out.
CREATE OR REPLACE VIEW grafana_tool_events AS
SELECT event_id, tool_id, kind, to_timestamp(at_us / 1e6) AS at, at_us, reason
FROM tool_events WHERE revoked_at_us IS NULL;
