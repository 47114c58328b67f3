"""The cross-check: ID buffers drawn by other code than the truth's, and compared with it. `drawing` puts the solids of
a scene into the world and has OpenGL draw them; `comparison` also says by rays through pixel centres where rounding may
decide what is seen. Nothing here that decides which pixels a solid has, or which solid is in front, is used by the
truth's fast path, and nothing of that path is used here: no outlines, no bodies, no clipping, no scan conversion, no
order."""
