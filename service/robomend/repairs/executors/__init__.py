"""Who carries out the actions of a plan: board, process, agent, webhook, all by one signature.

The signature is robomend_client.actions.Executor.

To add an executor, write a class with `execute` in a file of its own here, wrap it in `Once`, and name it in
`robomend.repairs.executors.configured`.
"""
