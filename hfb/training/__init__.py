"""Programs that make what hfb ships: its networks, priors, embedded body and confidence (`hfb train NAME`).

Nothing here is needed to run hfb; docs/howto/train-networks.md has the commands that made the shipped files.
"""
