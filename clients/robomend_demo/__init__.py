"""The paper's two scenarios, played by real processes: service, emulated board, devices, nodes, agent."""
