-- Distributes a Feedwright database over the workers of a Citus cluster, by machine.
--
-- Run it once on the coordinator, by psql with ON_ERROR_STOP, after `feedwright check` of this version has migrated the empty
-- database, and before any data is in it. Servers connect to the coordinator. Needs Citus 12 or newer
-- on PostgreSQL 15 or newer, with the workers added (citus_add_node) and citus.shard_replication_factor = 1.
--
-- Every distributed table is distributed by machine_id, every key of one contains it, no table has a foreign key, and
-- distributed tables are joined by it: a test of the project holds this file against the migrations and statements.

BEGIN;

-- Read with every cycle, written by people: a copy on each node.
SELECT create_reference_table('machines');
SELECT create_reference_table('tools');
SELECT create_reference_table('tool_events');
SELECT create_reference_table('operations');
SELECT create_reference_table('operation_asks');
SELECT create_reference_table('operation_setups');
-- By machine too, but written together with the audit and the registry's generation, which stay on the coordinator: a
-- change of one shard alone is committed apart from them, one of a table with a copy on each node is not.
SELECT create_reference_table('calibrations');
SELECT create_reference_table('retention');
SELECT create_reference_table('models');
SELECT create_reference_table('feed_profiles');
SELECT create_reference_table('feed_profile_versions');
-- What recommendations say, each text once: few, and read beside recommendations.
SELECT create_reference_table('advices');

-- One machine's rows stand together on one worker, so that a cycle with its samples and its wear is one worker's work.
SELECT create_distributed_table('cycles', 'machine_id');
SELECT create_distributed_table('cycle_samples', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('cycle_cuts', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('tool_wear', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('tool_wear_checkpoints', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('sample_drops', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('cycle_sample_drops', 'machine_id', colocate_with => 'cycles');
SELECT create_distributed_table('cycle_overrides', 'machine_id', colocate_with => 'cycles');
-- Asked for by their own id alone, which each worker then looks for.
SELECT create_distributed_table('recommendations', 'machine_id', colocate_with => 'cycles');

COMMIT;

-- These stay on the coordinator: few rows, keys without a machine, triggers, numbers in the order of arrival.
-- local: alarms
-- local: audit
-- local: quarantine
-- local: quarantine_claims
-- local: quarantine_fill
-- local: tokens
-- local: machine_contacts
-- local: tool_checkpoints
-- local: registry_generation
-- local: sessions
-- local: stream_leases
-- local: last_backup
-- local: retention_clock
-- local: write_probe
