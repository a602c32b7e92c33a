-- An event of a tool that was told by mistake, or by a clock that was ahead, is revoked: it stays, and holds no more.
ALTER TABLE tool_events ADD COLUMN revoked_at_us INTEGER;
ALTER TABLE tool_events ADD COLUMN revoked_by TEXT
    CONSTRAINT tool_events_revoked_by_length CHECK (length(revoked_by) BETWEEN 0 AND 1000)
    CONSTRAINT tool_events_revoked_whole CHECK ((revoked_at_us IS NULL) = (revoked_by IS NULL));
