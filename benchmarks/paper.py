"""The paper's experiment on a virtual actuator, beside the paper's numbers. Writes `paper.json`."""

import json
from pathlib import Path

from dehyst.paper import run


def main() -> None:
    found = run.run(print).as_dict()
    target = Path(__file__).with_name("paper.json")
    target.write_text(json.dumps(found, indent=1) + "\n")
    print(target.name)


if __name__ == "__main__":
    main()
