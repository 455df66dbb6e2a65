"""Maps of stability: what is asked (`question`), how it is answered (`answer`), which files hold it (`files`)."""
