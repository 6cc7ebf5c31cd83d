"""Why a run failed: futures that branch from it, each with other random numbers or with something left out.

``condition`` says what a failure is, ``causes`` what can be left out, ``futures`` carries futures out, ``search``
chooses them, and ``figure`` draws what they showed.
"""
