-- What is open is asked for by whose it is, and how much of the quarantine is filled by every line that cannot be accepted: neither may
-- take longer the more is open, or was. How much that is, is kept with each change of the quarantine, whoever makes it; it belongs to this
-- database: neither a backup nor a copy takes it along.

CREATE INDEX quarantine_unsettled_by_machine ON quarantine (machine_id, quarantine_id) WHERE settled_at_us IS NULL;
CREATE INDEX alarms_open_by_machine ON alarms (machine_id, alarm_id) WHERE cleared_at_us IS NULL;
CREATE INDEX alarms_open_by_tool ON alarms (tool_id, alarm_id) WHERE cleared_at_us IS NULL;
-- Not by the plain number: by that an engine may go through all that ever were, as they are in order.
CREATE INDEX alarms_open_by_number ON alarms ((alarm_id + 0)) WHERE cleared_at_us IS NULL;

CREATE TABLE quarantine_fill (
    only_row INTEGER PRIMARY KEY NOT NULL CONSTRAINT quarantine_fill_one_row CHECK (only_row = 1),
    entries INTEGER NOT NULL CONSTRAINT quarantine_fill_entries_range CHECK (entries BETWEEN 0 AND 9007199254740991),
    bytes INTEGER NOT NULL CONSTRAINT quarantine_fill_bytes_range CHECK (bytes BETWEEN 0 AND 9007199254740991)
) STRICT;

INSERT INTO quarantine_fill (only_row, entries, bytes)
SELECT 1, COUNT(*), COALESCE(SUM(stored_bytes), 0) FROM quarantine WHERE settled_at_us IS NULL;

CREATE TRIGGER quarantine_fill_came AFTER INSERT ON quarantine WHEN NEW.settled_at_us IS NULL BEGIN
    UPDATE quarantine_fill SET entries = entries + 1, bytes = bytes + NEW.stored_bytes;
END;

CREATE TRIGGER quarantine_fill_went AFTER DELETE ON quarantine WHEN OLD.settled_at_us IS NULL BEGIN
    UPDATE quarantine_fill SET entries = entries - 1, bytes = bytes - OLD.stored_bytes;
END;

CREATE TRIGGER quarantine_fill_changed AFTER UPDATE OF settled_at_us, stored_bytes ON quarantine BEGIN
    UPDATE quarantine_fill SET
        entries = entries + (NEW.settled_at_us IS NULL) - (OLD.settled_at_us IS NULL),
        bytes = bytes + iif(NEW.settled_at_us IS NULL, NEW.stored_bytes, 0) - iif(OLD.settled_at_us IS NULL, OLD.stored_bytes, 0);
END;
