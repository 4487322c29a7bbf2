"""Cohorts of the blind check: scans of one study, all or some of which hold one cause, each at a size of its own."""
