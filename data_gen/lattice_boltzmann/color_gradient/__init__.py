"""A dense emulsion in a constriction: the colour-gradient model of the paper's appendix A."""
