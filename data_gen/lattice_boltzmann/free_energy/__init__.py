"""Cores in a sheared shell: the free-energy model of the paper's appendix B."""
