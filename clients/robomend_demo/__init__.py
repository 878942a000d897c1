"""The paper's two scenarios and two more, played by real processes: service, emulated board, devices, nodes,
agent.
"""
