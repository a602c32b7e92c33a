-- A fold is squeezed by who writes it: the database does not try it once more, which took it longer than writing it. By itself, as a group that
-- is written has looked at folds before it wants cycles.
-- Tables that are distributed over nodes by Citus cannot be told so, and go on as they are.
DO $$
BEGIN
    ALTER TABLE tool_wear ALTER COLUMN state SET STORAGE EXTERNAL;
    ALTER TABLE tool_wear_checkpoints ALTER COLUMN state SET STORAGE EXTERNAL;
EXCEPTION WHEN feature_not_supported THEN
    NULL;
END
$$;
