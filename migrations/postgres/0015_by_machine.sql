-- Recommendations stand by their machine too, as everything does that grows with the cycles: what is spread over several
-- nodes is spread by machine. (In SQLite folds also move to an ordinary table; here they stand in one.)

ALTER TABLE recommendations ADD COLUMN machine_id TEXT COLLATE "C"
    CONSTRAINT recommendations_machine_id_length CHECK (length(machine_id) BETWEEN 1 AND 128);
-- Without its advice nobody knows whose one was; it is kept all the same.
UPDATE recommendations r SET machine_id = COALESCE(
    (SELECT a.body::JSON ->> 'machine' FROM advices a WHERE a.advice_hash = r.advice_hash), 'unknown');
ALTER TABLE recommendations ALTER COLUMN machine_id SET NOT NULL;
-- An id says nothing of its machine, and is asked for alone.
ALTER TABLE recommendations DROP CONSTRAINT recommendations_pkey;
ALTER TABLE recommendations ADD PRIMARY KEY (recommendation_id, machine_id);
