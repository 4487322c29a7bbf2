"""What a design could ever tell, as a table in a terminal."""

from __future__ import annotations

from petkin.diagnosis import ABSORBED, Visible


def design_table(visible: tuple[Visible, ...]) -> str:
    """d' at the end of the plausible range, what the refit keeps, and the likeliest double, a line an effect."""
    lines = [f"  {'effect':24}{'d prime':>9}{'kept':>10}  taken for"]
    for v in sorted(visible, key=lambda v: -v.detectability):
        partners = ", ".join(f"{name} ({cosine:.2f})" for name, cosine in v.partners[:2])
        hidden = "  cannot be seen" if v.invisible else ""
        lines.append(f"  {v.hypothesis.name:24}{v.detectability:9.2f}{_percent(v.kept):>10}  {partners}{hidden}")
    return "\n".join(lines)


def _percent(share: float) -> str:
    return f"{100 * share:.2g}%" if share >= ABSORBED else "none"
