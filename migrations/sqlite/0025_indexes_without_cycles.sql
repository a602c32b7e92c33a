-- Indexes over time no longer hold the ids of cycles, nor of machines where those do not part equal times. Cycles of one time are
-- put in their order when they are read, as those of a machine, of an operation and of all were before: what orders them, their count at the
-- machine, was in none of these indexes. That of tools, which gives the order of the fold, keeps it.

DROP INDEX cycles_by_tool;
DROP INDEX cycles_by_operation;
DROP INDEX cycles_by_machine;
DROP INDEX cycles_by_time;
CREATE INDEX cycles_by_tool ON cycles (tool_id, started_at_us, machine_id, COALESCE(seq, -1));
CREATE INDEX cycles_by_operation ON cycles (operation_id, started_at_us);
CREATE INDEX cycles_by_machine ON cycles (machine_id, started_at_us);
CREATE INDEX cycles_by_time ON cycles (started_at_us);
