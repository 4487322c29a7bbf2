"""Moving bodies of the blind check: runs of five systems whose effect is withheld."""
