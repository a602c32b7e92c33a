-- PostgreSQL's view of events for dashboards leaves out those that were revoked. SQLite has no such views.

SELECT 1;
