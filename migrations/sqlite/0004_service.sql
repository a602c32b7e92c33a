-- What keeps the service honest: quarantine, audit, tokens, and the probe that proves writing.

-- What could not be accepted; the body is compressed as it came.
CREATE TABLE quarantine (
    quarantine_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT quarantine_quarantine_id_length CHECK (length(quarantine_id) BETWEEN 1 AND 128),
    machine_id TEXT NOT NULL
        CONSTRAINT quarantine_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    cycle_id TEXT CONSTRAINT quarantine_cycle_id_length CHECK (length(cycle_id) BETWEEN 0 AND 1000),
    received_at_us INTEGER NOT NULL,
    code TEXT NOT NULL CONSTRAINT quarantine_code_length CHECK (length(code) BETWEEN 0 AND 200),
    problem TEXT NOT NULL,
    content_type TEXT NOT NULL
        CONSTRAINT quarantine_content_type_length CHECK (length(content_type) BETWEEN 0 AND 1000),
    size INTEGER NOT NULL CONSTRAINT quarantine_size_range CHECK (size BETWEEN 0 AND 1099511627776),
    stored_bytes INTEGER NOT NULL
        CONSTRAINT quarantine_stored_bytes_range CHECK (stored_bytes BETWEEN 0 AND 1099511627776),
    body BLOB NOT NULL,
    body_hash BLOB NOT NULL CONSTRAINT quarantine_body_hash_length CHECK (length(body_hash) = 32),
    settled_at_us INTEGER,
    settled_how TEXT CONSTRAINT quarantine_settled_how_length CHECK (length(settled_how) BETWEEN 0 AND 10000),
    CONSTRAINT quarantine_settled_whole CHECK ((settled_at_us IS NULL) = (settled_how IS NULL))
) STRICT;

CREATE UNIQUE INDEX quarantine_once ON quarantine (machine_id, COALESCE(cycle_id, ''), body_hash);
CREATE INDEX quarantine_by_machine ON quarantine (machine_id, quarantine_id);
CREATE INDEX quarantine_unsettled ON quarantine (quarantine_id, machine_id, stored_bytes) WHERE settled_at_us IS NULL;

-- Who changed what: lines are added, never changed nor removed.
CREATE TABLE audit (
    audit_id INTEGER PRIMARY KEY AUTOINCREMENT,
    at_us INTEGER NOT NULL,
    actor TEXT NOT NULL CONSTRAINT audit_actor_length CHECK (length(actor) BETWEEN 0 AND 1000),
    role TEXT NOT NULL
        CONSTRAINT audit_role_word CHECK (role IN ('machine', 'viewer', 'engineer', 'approver', 'admin')),
    action TEXT NOT NULL CONSTRAINT audit_action_length CHECK (length(action) BETWEEN 0 AND 200),
    subject TEXT NOT NULL CONSTRAINT audit_subject_length CHECK (length(subject) BETWEEN 0 AND 1000),
    detail TEXT NOT NULL
) STRICT;

CREATE TRIGGER audit_refuses_update BEFORE UPDATE ON audit
BEGIN
    SELECT RAISE(ABORT, 'audit is append-only');
END;

CREATE TRIGGER audit_refuses_delete BEFORE DELETE ON audit
BEGIN
    SELECT RAISE(ABORT, 'audit is append-only');
END;

-- Only hashes of secrets.
CREATE TABLE tokens (
    token_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT tokens_token_id_length CHECK (length(token_id) BETWEEN 1 AND 128),
    name TEXT NOT NULL CONSTRAINT tokens_name_length CHECK (length(name) BETWEEN 0 AND 1000),
    secret_hash BLOB NOT NULL UNIQUE CONSTRAINT tokens_secret_hash_length CHECK (length(secret_hash) = 32),
    role TEXT NOT NULL
        CONSTRAINT tokens_role_word CHECK (role IN ('machine', 'viewer', 'engineer', 'approver', 'admin')),
    machine_id TEXT CONSTRAINT tokens_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128),
    created_at_us INTEGER NOT NULL,
    revoked_at_us INTEGER,
    CONSTRAINT tokens_machine_bound CHECK ((role = 'machine') = (machine_id IS NOT NULL))
) STRICT;

CREATE TABLE write_probe (
    probe_id INTEGER PRIMARY KEY NOT NULL CONSTRAINT write_probe_one_row CHECK (probe_id = 1),
    probed_at_us INTEGER NOT NULL
) STRICT;
