"""How droplets pass a line, stay in a region, turn; and the numbers of the flow."""
