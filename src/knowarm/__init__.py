"""Deep reinforcement learning for robot arms, with commonsense from a knowledge graph.

A policy sees an image of one of several objects and moves a robot arm to its grasp point. Triples
of a knowledge graph about these objects become a vector that enters the policy network::

    triples -> subgraph -> sentence -> vectors -> scene embedding ----.
                                                                      policy -> action
    MJCF -> scene -> batch simulation -> image -----------------------'

Train the paper's agent and its baseline, evaluate both on the same episodes, and compare them::

    import knowarm

    for name in ("irb120-full-fast", "irb120-bm-fast"):
        run = knowarm.train(name, runs="runs")
        knowarm.evaluate(run, episodes=1000)
    knowarm.write_report(["runs"], "runs/report.html")

Use one part alone::

    env = knowarm.make("irb120", task="choose", num_envs=64)  # a Gymnasium vector environment
    graph = knowarm.read_graph("kitchen.ttl")           # RDF, ConceptNet, OpenKE or a table
    config = knowarm.KnowledgeConfig(detail="full")
    vector = knowarm.scene_embedding(config, [("mug", "red"), ("bottle", "yellow")]).vector
    agent = knowarm.load_agent("zoo/irb120-full-fast")  # an agent, its policy and its config
    agent.reset(info)                                   # infos of any environment's reset
    action = agent.act(image)                           # once per step

Experiments
    train               train a named experiment or a config, or resume a run
    evaluate            play fixed episodes and measure returns, accuracy and success
    ask, Asked          ask a trained agent a question that a graph answers
    load_agent          load the trained agent of a run
    push_to_hub         share a run on the Hugging Face Hub (extra "hub")
    from_pretrained     load the trained agent of a repository of the Hub
    write_report        write one HTML page that compares runs
    experiment_config   the config of a named experiment, with overrides
    experiment_names    the names of all experiments
    ExperimentConfig    everything that defines a training run
    EvaluationConfig    episodes and thresholds of an evaluation
    Run, TrainedAgent, EvaluationResult    what train, load_agent and evaluate return
Studies
    read_study          read a table of experiments and seeds: a shipped one, or a TOML file
    run_study           train and evaluate all of its runs, restartable
    StudyConfig         experiments, seeds, overrides, evaluations
World
    make                make an environment: single or vector, NumPy or torch
    EnvConfig           robot, task, objects, colours, dynamics and thresholds
    ArmEnv              single environment (Gymnasium)
    ArmVectorEnv        vector environment on NumPy arrays (Gymnasium)
    TorchArmVectorEnv   vector environment on torch tensors
    Robot               the fields of a robot's TOML description
    VisualRandomization, HeldOut    what varies in the image; colours and places held out
    evaluation_episodes draw a fixed list of episodes
    Episodes            start conditions of episodes
    play                play a list of episodes with an agent
    OracleAgent         moves to the true goal by inverse kinematics
Tasks
    Task                what is asked, and what has to be done
    Asking              base of what is asked; derive your own from it
    AskNothing, AskObject    one object; the object, of several, that answers a question
    AskInstance         as AskObject, with objects whose kinds have many instances
    AskPart             the part of an object that answers a question
    Skill               base of skills; derive your own from it
    Reach, Lift         reach an object; close the fingers and lift it
    EpisodeState        the running episodes, the argument of these methods
    TASKS, ASKED, SKILLS, register_task    names of tasks; their parts; add one of your own module
    NameQueries, GraphQueries    questions from names, or answered by a graph
    Query, QuestionTable    conditions on an object; questions and the objects that answer them
Knowledge
    read_graph          read a graph from a file
    KnowledgeGraph      triples, entities and relations
    KnowledgeConfig     from a graph to the knowledge vector
    NoKnowledge, Vector, Grounded    what an agent knows: `ExperimentConfig.knows`
    scene_embedding     compute the knowledge vector of a scene
    query_embedding     compute the knowledge vectors of queries
    SceneEmbedding      vectors with their slots, coverage and sentences
    parse_query         read a query such as "usedFor drinking and hasColor blue"
Perception
    GroundingConfig     training of networks that name and locate objects in an image
Policy and learning
    Policy              the recurrent network
    PolicyConfig        choices of the network: fusion, sizes, preprocessing
    PolicyShape         its input and output sizes
    PolicyAgent         plays episodes with a policy
    PPOConfig, DistilConfig, A3CConfig    hyperparameters of the algorithms
    NumpyToTorch        adapter of any NumPy vector environment for the trainers
    SB3Run              callback of Stable-Baselines3 that writes a run folder (extra "sb3")
    SB3VecEnv           adapter of a vector environment for Stable-Baselines3 (extra "sb3")
Registries: to extend KnowArm, add an entry (see CONTRIBUTING.md)
    AGENTS, Agent       knowledge, policy and role of each agent
    ALGORITHMS, Algorithm    config and trainer of each learning algorithm
    register_algorithm  add one of your own module
    ROBOTS              robots by name
    TARGETS             target objects by name
Errors
    UserError           a mistake in an argument, config or file, with its remedy

Public names are imported when they are first used, so that ``import knowarm`` stays fast. Importing
the package registers its Gymnasium ids (``knowarm/IRB120Reach-v0``). The command line is ``knowarm
--help``, the documentation is in ``docs/``.
"""

import lazy_loader

from knowarm.memory_limit import check_memory_limit

check_memory_limit()

from knowarm.world import register_environments  # noqa: E402 (loads libraries)

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

register_environments()
