"""Tests of the project. They keep compiled code where the command does."""

from dynamics.compiled_code import keep_compiled_code

keep_compiled_code()  # before conftest imports compiled functions, whose directory is chosen at the import
