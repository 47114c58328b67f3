"""What the vessels of a run would send by AIS (ITU-R M.1371), as a receiver logs it.

- `stations` says which vessels carry class A or B, under which number and name; its table is `carriage.yaml`;
- `stays` follows the antenna of a vessel, and `sensors` measures that track once a second;
- `reporting` says when a station sends, and which of its reports are lost;
- `sentences` encodes a report, through pyais; `log` writes them all in order of time.
"""
