"""The command `modsim3d scenes`."""

from modsim3d.cli.shared import JsonOption, print_line
from modsim3d.cli.terminal import open_console, say_json
from modsim3d.cli.terminal_tables import print_prose


def scenes_command(json: JsonOption = False) -> None:
    """List the shipped scenes, and the detection conditions for --state NAME --from conditions.

    Example: modsim3d scenes
    """
    from modsim3d.io.validation import CONDITIONS, conditions_in
    from modsim3d.scene.reading import draws_traffic, shipped_scenes

    console, entries = open_console(), []
    for name, path in shipped_scenes().items():
        with path.open(encoding="utf-8") as file:
            title = file.readline().strip("# \n")
        drawn = draws_traffic(path)
        entries.append({"name": name, "title": title, "path": path, "traffic_drawn": drawn})
        print_line(console, name, "bold")
        print_prose(console, title, indent=4)
        print_line(console, f"    traffic: {'drawn from the seed' if drawn else 'this traffic only'}")
        print_line(console, f"    {path}", "dim")
    print_line(console, f"--from {CONDITIONS}", "bold")
    print_prose(console, ", ".join(conditions_in()), indent=4)
    say_json({"format": 1, "command": "scenes", "scenes": entries, "conditions": list(conditions_in())})
