"""Files of tracks: what each may hold, and what is wrong with one."""
