"""Speed and statistics over many draws. Compiled code is kept in the `rig` command's place."""

from dynamics.compiled_code import keep_compiled_code

keep_compiled_code()  # before a benchmark imports anything that compiles
