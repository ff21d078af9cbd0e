# Public names of the package: what type checkers see, and what __init__.py imports on first use.
from .agent import PolicyAgent as PolicyAgent
from .config import PolicyConfig as PolicyConfig
from .config import PolicyShape as PolicyShape
from .lstm import State as State
from .policy import MakePolicy as MakePolicy
from .policy import MatmulPrecision as MatmulPrecision
from .policy import Policy as Policy
from .policy import entropy as entropy
from .policy import log_probability as log_probability
from .policy import matched_without_knowledge as matched_without_knowledge
