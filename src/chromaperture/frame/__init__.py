"""What is measured from one photograph, and what is made of it: files, points, pictures, objects of other libraries.

Everything here takes a finished `DepthFrame` or its arrays; nothing measures.
"""
