"""Frames -> boxes: the detector, the engines that run the network, the choice of one."""
