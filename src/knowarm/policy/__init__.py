"""Recurrent policy: image encoder, knowledge fusion, LSTM, actor and critic heads.

Modules in the order of the forward pass: `config` (choices and shapes), `encoder`, `fusion`,
`lstm`, `policy`, `agent`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
