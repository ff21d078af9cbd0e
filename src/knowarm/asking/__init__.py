"""Questions to a graph and to a trained agent: languages, answers, scenes, a page in the browser.

The package is not called ``ask``: `knowarm.ask` is a function.
"""
