-- Operations whose change makes their cycles judged otherwise are numbered in the order of such changes, and each fold says up to which
-- of them it has gone along: a change is written at once, however long the history is, and folds follow one by one.
ALTER TABLE operations ADD COLUMN judging_change INTEGER NOT NULL DEFAULT 0
    CONSTRAINT operations_judging_change_range CHECK (judging_change BETWEEN 0 AND 9007199254740991);
CREATE INDEX operations_judging_change ON operations (judging_change) WHERE judging_change > 0;
ALTER TABLE tool_wear ADD COLUMN judging_change INTEGER NOT NULL DEFAULT 0
    CONSTRAINT tool_wear_judging_change_range CHECK (judging_change BETWEEN 0 AND 9007199254740991);
