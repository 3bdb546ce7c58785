"""V2X-VLM's training: from a cooperative recording to a checkpoint.

prompts      what the model is told
tokenizer    a small one of our own, or Florence-2's
dataset      pictures, prompts and waypoints, made of a recording once
objective    the loss
pretrained   Florence-2's published weights, from a folder
evaluation   L2 and collisions on sequences that were held out
run          all of it, as `anchorflow train` does it
"""
