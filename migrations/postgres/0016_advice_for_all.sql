-- Whom a recommendation was for stands with it, no longer in its advice: what many machines and tools are told alike is kept
-- once. Rows of before have it in their advice, and are not touched. (In SQLite checkpoints also move to an ordinary
-- table; here they stand in one.) One statement: on several nodes
-- each is sent on with the whole text that it came in.

ALTER TABLE recommendations
    ADD COLUMN operation_id TEXT COLLATE "C"
        CONSTRAINT recommendations_operation_id_length CHECK (length(operation_id) BETWEEN 1 AND 128),
    ADD COLUMN tool_id TEXT COLLATE "C"
        CONSTRAINT recommendations_tool_id_length CHECK (length(tool_id) BETWEEN 1 AND 128);
