"""Pack a staged tree as a reproducible .deb, with control files, checksums and modes."""

from __future__ import annotations

import hashlib
import os
import subprocess
from pathlib import Path

SCRIPTS = ("postinst", "prerm", "postrm")
PLAIN = ("control", "conffiles", "md5sums")


def control_folder(stage: Path) -> Path:
    """Return the folder of control files in a staged tree, created if missing."""
    folder = stage / "DEBIAN"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_control(stage: Path, fields: dict[str, str]) -> int:
    """Write control, conffiles and md5sums and set all modes; return the installed size in KiB."""
    files = sorted(p for p in stage.rglob("*") if "DEBIAN" not in p.parts)
    kib = sum(p.lstat().st_size for p in files) // 1024
    lines = [f"{key}: {value}" for key, value in {**fields, "Installed-Size": str(kib)}.items()]
    control = control_folder(stage)
    (control / "control").write_text("\n".join(lines) + "\n")
    names = {p.relative_to(stage): p for p in files if p.is_file() and not p.is_symlink()}
    conffiles = [f"/{name}\n" for name in names if name.parts[0] == "etc"]
    if conffiles:
        (control / "conffiles").write_text("".join(conffiles))
    sums = [
        f"{hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest()}  {name}\n"
        for name, path in names.items()
        if name.parts[0] != "etc"
    ]
    (control / "md5sums").write_text("".join(sums))
    for path in [stage, *stage.rglob("*")]:
        if not path.is_symlink():
            runs = path.is_dir() or path.parent.name == "bin" or path.parent == control
            path.chmod(0o755 if runs and path.name not in PLAIN else 0o644)
    return kib


def pack(stage: Path, out: Path, fields: dict[str, str], epoch: str) -> tuple[Path, str]:
    """Build the .deb of a staged tree, with no time after `epoch`; also a line on its size."""
    kib = write_control(stage, fields)
    deb = out / f"{fields['Package']}_{fields['Version']}_{fields['Architecture']}.deb"
    command = ["dpkg-deb", "--root-owner-group", "-Zzstd", "-z12", "--build", str(stage), str(deb)]
    environment = {**os.environ, "SOURCE_DATE_EPOCH": epoch}
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    return deb, f"{deb}: {deb.stat().st_size / 1e6:.0f} MB, installed {kib / 1024:.0f} MiB"
