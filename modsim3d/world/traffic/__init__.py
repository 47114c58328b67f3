"""Traffic that is drawn from the seed: routes, speeds, times, types and sizes of vessels. Vessels are planned one after
another in the order of their right of way: own ship, encounters with her, lanes in their order, leisure craft. Each is
compared with the whole way of all before her (`clearance`). If she does not keep well clear, the best of many whole
changed ways is taken, as the dynamic window approach takes the best arc (`world.poses.agents`); she is drawn anew if
none is admissible, and left out and counted if that fails too. So no two hulls ever touch. `keys` says what a scene
file can ask for, `generate` draws it."""
