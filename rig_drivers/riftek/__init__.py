"""RIFTEK RF60x displacement sensors (sold as Acuity AR100 and AR500 too) on a serial line."""
