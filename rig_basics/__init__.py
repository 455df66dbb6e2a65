"""What every package needs: units and array types. It imports no other package of the project."""
