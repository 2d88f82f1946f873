"""The paper from one command: its data sets, networks, flows, figures, tables and numbers."""
