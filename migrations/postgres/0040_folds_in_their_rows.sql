-- A fold of some thousand bytes was kept beside its row, in two pieces with an index of their own, of which every group of cycles wrote all anew and left
-- what was there before: twice as many bytes as the samples, until a vacuum came by. In its row it is written over in the page that it stands in, which
-- has room for that.
-- Tables that are distributed over nodes by Citus cannot be told so everywhere, and go on as they are.
DO $$
BEGIN
    ALTER TABLE tool_wear SET (toast_tuple_target = 8160, fillfactor = 50);
EXCEPTION WHEN feature_not_supported THEN
    NULL;
END
$$;
