-- A fold of more than 2 kB was kept beside its row, in pieces with an index of their own, of which every group of cycles wrote all anew and left what was
-- there before until a vacuum came by: of the usual 3 kB twice as many bytes as the samples. In its row it is written over in the page that it stands in,
-- where both the old and the new one have room, which they have up to 4,000 bytes. Longer ones stand beside their rows as before: in them each would take
-- another page, and write every index.
-- Tables that are distributed over nodes by Citus cannot be told so everywhere, and go on as they are.
DO $$
BEGIN
    ALTER TABLE tool_wear SET (toast_tuple_target = 4000, fillfactor = 50);
EXCEPTION WHEN feature_not_supported THEN
    NULL;
END
$$;
