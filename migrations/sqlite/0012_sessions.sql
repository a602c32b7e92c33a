-- Sessions of browsers: only hashes of their secrets. A session ends with its time, with its token, or by hand.
CREATE TABLE sessions (
    session_hash BLOB PRIMARY KEY NOT NULL
        CONSTRAINT sessions_session_hash_length CHECK (length(session_hash) = 32),
    token_id TEXT NOT NULL CONSTRAINT sessions_token_id_length CHECK (length(token_id) BETWEEN 1 AND 128),
    created_at_us INTEGER NOT NULL,
    expires_at_us INTEGER NOT NULL,
    CONSTRAINT sessions_end_after_begin CHECK (expires_at_us > created_at_us)
) WITHOUT ROWID, STRICT;

CREATE INDEX sessions_by_token ON sessions (token_id, created_at_us, session_hash);
CREATE INDEX sessions_by_expiry ON sessions (expires_at_us);
