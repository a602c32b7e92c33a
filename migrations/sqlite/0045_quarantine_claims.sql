-- Who is settling an entry of the quarantine: of two repairs that come to two servers at one moment both were stored, and one was told that
-- it was not. The row goes when the entry is settled, or its repair is refused; one whose server ended meanwhile is over by itself.

CREATE TABLE quarantine_claims (
    quarantine_id TEXT PRIMARY KEY NOT NULL
        CONSTRAINT quarantine_claims_quarantine_id_length CHECK (length(quarantine_id) BETWEEN 1 AND 128),
    holder TEXT NOT NULL CONSTRAINT quarantine_claims_holder_length CHECK (length(holder) BETWEEN 1 AND 128),
    expires_at_us INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
