"""The lights of vessels by night, by the COLREG of 1972.

`kinds` tells sailing vessels from others, `rules` says which lights a vessel shows, `lantern` how strong each is and
where it is seen, and `seen` which of them a camera sees.
"""
