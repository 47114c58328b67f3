"""Messages that the vessels of a run would send by AIS (ITU-R M.1371), as a receiver logs them.

- `sensors` says which vessels carry class A or B, under which number and name (its table is `carriage.yaml`), and
  measures the track of a vessel's antenna once a second;
- `reporting` says when a station sends, and which of its reports are lost;
- `log` encodes reports, through pyais, and writes them all in order of time."""
