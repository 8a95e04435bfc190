"""What goes over HTTP: the verbs of a server, the bodies that they take and their answers, each declared once.

A server reads bodies and writes answers with these models, a client the other way round, and the description of the
interface (OpenAPI) is made of them.
"""
