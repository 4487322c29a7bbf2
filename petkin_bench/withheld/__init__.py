"""Withheld effects: scans of an independent generator, what the product says of them, and how often it is right."""
