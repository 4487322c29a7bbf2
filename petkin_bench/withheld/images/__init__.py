"""Image cases of the blind check: small 4-D scans with a segmentation, whose spatial effect is withheld."""
