-- What is open is asked for by whose it is, and how much of the quarantine is filled by every line that cannot be accepted: neither may
-- take longer the more is open, or was. How much that is, is kept with each change of the quarantine, whoever makes it; it belongs to this
-- database: neither a backup nor a copy takes it along.

CREATE INDEX quarantine_unsettled_by_machine ON quarantine (machine_id, quarantine_id) WHERE settled_at_us IS NULL;
CREATE INDEX alarms_open_by_machine ON alarms (machine_id, alarm_id) WHERE cleared_at_us IS NULL;
CREATE INDEX alarms_open_by_tool ON alarms (tool_id, alarm_id) WHERE cleared_at_us IS NULL;
-- Not by the plain number: by that an engine may go through all that ever were, as they are in order.
CREATE INDEX alarms_open_by_number ON alarms ((alarm_id + 0)) WHERE cleared_at_us IS NULL;

CREATE TABLE quarantine_fill (
    only_row BIGINT PRIMARY KEY NOT NULL CONSTRAINT quarantine_fill_one_row CHECK (only_row = 1),
    entries BIGINT NOT NULL CONSTRAINT quarantine_fill_entries_range CHECK (entries BETWEEN 0 AND 9007199254740991),
    bytes BIGINT NOT NULL CONSTRAINT quarantine_fill_bytes_range CHECK (bytes BETWEEN 0 AND 9007199254740991)
);

-- A server of the version before, which is at work meanwhile, adds nothing between the count and the triggers.
LOCK TABLE quarantine IN SHARE ROW EXCLUSIVE MODE;

INSERT INTO quarantine_fill (only_row, entries, bytes)
SELECT 1, COUNT(*), COALESCE(SUM(stored_bytes), 0)::BIGINT FROM quarantine WHERE settled_at_us IS NULL;

-- Once for a statement: a copy brings many rows in one transaction, each of whose changes of the one row the next would go through.
CREATE FUNCTION quarantine_fill_follows() RETURNS TRIGGER LANGUAGE plpgsql AS $$
DECLARE
    entries_more BIGINT := 0;
    bytes_more BIGINT := 0;
    some_entries BIGINT;
    some_bytes BIGINT;
BEGIN
    IF TG_OP <> 'DELETE' THEN
        SELECT COUNT(*), COALESCE(SUM(stored_bytes), 0) INTO some_entries, some_bytes FROM came WHERE settled_at_us IS NULL;
        entries_more := some_entries;
        bytes_more := some_bytes;
    END IF;
    IF TG_OP <> 'INSERT' THEN
        SELECT COUNT(*), COALESCE(SUM(stored_bytes), 0) INTO some_entries, some_bytes FROM went WHERE settled_at_us IS NULL;
        entries_more := entries_more - some_entries;
        bytes_more := bytes_more - some_bytes;
    END IF;
    IF entries_more <> 0 OR bytes_more <> 0 THEN
        UPDATE quarantine_fill SET entries = entries + entries_more, bytes = bytes + bytes_more;
    END IF;
    RETURN NULL;
END $$;

CREATE FUNCTION quarantine_fill_is_none() RETURNS TRIGGER LANGUAGE plpgsql AS $$
BEGIN
    UPDATE quarantine_fill SET entries = 0, bytes = 0;
    RETURN NULL;
END $$;

CREATE TRIGGER quarantine_fill_came AFTER INSERT ON quarantine REFERENCING NEW TABLE AS came
    FOR EACH STATEMENT EXECUTE FUNCTION quarantine_fill_follows();
CREATE TRIGGER quarantine_fill_went AFTER DELETE ON quarantine REFERENCING OLD TABLE AS went
    FOR EACH STATEMENT EXECUTE FUNCTION quarantine_fill_follows();
CREATE TRIGGER quarantine_fill_changed AFTER UPDATE ON quarantine REFERENCING OLD TABLE AS went NEW TABLE AS came
    FOR EACH STATEMENT EXECUTE FUNCTION quarantine_fill_follows();
CREATE TRIGGER quarantine_fill_emptied AFTER TRUNCATE ON quarantine
    FOR EACH STATEMENT EXECUTE FUNCTION quarantine_fill_is_none();
