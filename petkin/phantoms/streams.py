"""Random streams by name: what one subject draws does not depend on how many others there are, or in which order."""

from __future__ import annotations

import zlib

import numpy as np


def random_stream(seed: int, purpose: str, subject: int = 0, session: int = 0) -> np.random.Generator:
    """An independent generator for one purpose of one scan.

    Args:
        seed: of the study, 0 or more.
        purpose: any word, e.g. "noise"; different words give independent streams.
        subject: number of the subject; 0 for what all subjects share.
        session: number of the session; 0 for what all sessions of the subject share.
    """
    key = (zlib.crc32(purpose.encode()), subject, session)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
