"""Examples of the commands, which `--help` prints; the tests parse each."""

from __future__ import annotations

# command -> (what to type, what it does)
EXAMPLES: dict[str, list[tuple[str, str]]] = {
    "setup": [
        ("calm-edge setup", "answer the questions; writes kit.toml"),
        ("calm-edge setup --page", "the same on a page: open the address that it prints"),
        ("calm-edge setup --yes --spacing-m 0.52", "ask nothing; the first camera is the primary"),
        ("calm-edge setup --sequence demo/drive", "try it without cameras"),
    ],
    "record": [
        ("calm-edge record --config kit.toml --out drives/monday", "until Ctrl-C"),
        ("calm-edge record --config kit.toml --root /data/drives", "a new folder for each drive"),
        ("calm-edge record --sequence demo/drive --spacing-m 0.5 --out drives/demo", "a replay"),
    ],
    "live": [("calm-edge live", "open the address that it prints in a browser")],
    "import": [
        ("calm-edge import front.mp4 side.mp4 --spacing-m 0.52 --out drives/tuesday", "two videos"),
        ("calm-edge import V1_01_easy --out drives/v101", "a data set, as published"),
    ],
    "map": [
        ("calm-edge map drives/monday --out maps/monday", "map.html, report.html, map.ply ..."),
        ("calm-edge map drives/monday --out maps/monday --resume", "go on after an interruption"),
    ],
    "report": [("calm-edge report drives/monday", "report.html in the folder")],
    "compare": [("calm-edge compare drives/monday drives/tuesday", "kit, lengths, losses, times")],
    "eval": [
        ("calm-edge eval maps/demo --truth demo/drive", "errors as a table"),
        ("calm-edge eval drives/demo --truth demo/drive --json", "for programs"),
    ],
    "export": [
        ("calm-edge export drives/monday --to tum --out poses", "a trajectory"),
        ("calm-edge export maps/monday --to colmap --out colmap", "cameras, pictures, points"),
    ],
    "calibration": [
        ("calm-edge calibration drives/monday --format ros --out calibration", "for image_proc")
    ],
    "recover": [("calm-edge recover drives/monday", "beside the recording")],
    "validate": [("calm-edge validate drives/monday", "reads every byte")],
    "keep": [
        ("calm-edge keep drives/000012-1a2b3c4d", "is not removed when the disk is full"),
        ("calm-edge keep --release drives/000012-1a2b3c4d", "may be removed again"),
    ],
    "cameras": [
        ("calm-edge cameras", "addresses, formats and controls"),
        ("calm-edge cameras --identify --write kit.toml", "by unplugging one at a time"),
    ],
    "model": [
        ("calm-edge model list", "names, and the results of check on this machine"),
        ("calm-edge model check calm-geo", "is it right here, and how fast"),
    ],
    "config": [
        ("calm-edge config", "all keys with their descriptions and defaults"),
        ("calm-edge config --spacing-m 0.52 --changed > kit.toml", "a file for record --config"),
        ("calm-edge config drives/monday", "what a recording was made with"),
    ],
    "doctor": [
        ("calm-edge doctor", "everything, with the remedies"),
        ("calm-edge doctor --measure", "also measure whether poses keep up"),
        ("calm-edge doctor --config kit.toml --out drives --json", "for programs"),
    ],
    "completion": [
        (
            "calm-edge completion bash > ~/.local/share/bash-completion/completions/calm-edge",
            "for bash, from the next shell on",
        ),
        ("calm-edge completion zsh > ~/.zfunc/_calm-edge", "a folder of $fpath"),
    ],
}


def table(command: str) -> str:
    """The examples of a command: each below what it does."""
    lines = [f"  # {what}\n  {line}" for line, what in EXAMPLES[command]]
    return "\n".join(["examples:", *lines])
