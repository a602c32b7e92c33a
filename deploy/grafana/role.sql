-- The role that Grafana reads with; run once by who may make roles (postgres, say), after Feedwright's first start:
--   psql -v password="'…'" -f role.sql feedwright
-- It sees the views that are made for dashboards, none of the tables behind them (tokens, audit, bodies in quarantine),
-- and a query that a dashboard's author got wrong ends by itself.
\set ON_ERROR_STOP on
SELECT 'CREATE ROLE feedwright_grafana LOGIN'
WHERE NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'feedwright_grafana') \gexec
ALTER ROLE feedwright_grafana PASSWORD :password;
ALTER ROLE feedwright_grafana SET statement_timeout = '20s';
ALTER ROLE feedwright_grafana SET default_transaction_read_only = on;
ALTER ROLE feedwright_grafana CONNECTION LIMIT 8;
GRANT SELECT ON grafana_machines, grafana_cycles, grafana_tools, grafana_tool_events, grafana_alarms,
    grafana_quarantine TO feedwright_grafana;
