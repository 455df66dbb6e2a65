"""RIFTEK RF60x (Acuity AR100, AR500) displacement sensors on Ethernet."""
