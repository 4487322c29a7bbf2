"""The BIDS inheritance principle: which files at higher levels apply to a file."""

from __future__ import annotations

from pathlib import Path

from petkin.io.names import FileName


def inherited(root: Path, path: Path, extension: str) -> list[Path]:
    """Files of an extension that apply to `path`, top first, those with fewer entities first within a folder.

    One applies if it has the same suffix and no entity that `path` lacks or labels otherwise.

    Args:
        root: top of the dataset or pipeline; `path` lies below it.
        path: the data file; it need not exist.
        extension: ".json" or ".tsv".
    """
    name = FileName.parse(path)
    folders = [root]
    for part in path.parent.relative_to(root).parts:
        folders.append(folders[-1] / part)
    return [file for folder in folders for file in _applying(folder, name, extension)]


def _applying(folder: Path, name: FileName, extension: str) -> list[Path]:
    found = []
    for file in folder.glob(f"*{name.suffix}{extension}") if folder.is_dir() else ():
        other = FileName.parse(file)
        if (other.suffix, other.extension) == (
            name.suffix,
            extension,
        ) and other.entities.items() <= name.entities.items():
            found.append((len(other.entities), file.name, file))
    return [file for _, _, file in sorted(found)]
