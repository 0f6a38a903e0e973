"""Mappings proposed for foreign files, from names and kinematics.

`propose_mapping` guesses which column is which channel, in which unit and frame and with which
sign, says how sure each guess is, and writes a mapping to edit. Hypotheses of all columns are
compared by their posterior odds: names give the prior, relations between columns the likelihood.

May import the readers, mappings and the audit, whose tests of actuators it uses. Needs no JAX.
"""

from diffsea.recordings.mapping_proposal.guessed_actuators import (
    native_with_guessed_actuators as native_with_guessed_actuators,
)
from diffsea.recordings.mapping_proposal.guessed_actuators import (
    with_guessed_actuators as with_guessed_actuators,
)
from diffsea.recordings.mapping_proposal.guesses import SURE as SURE
from diffsea.recordings.mapping_proposal.names import Suggestion as Suggestion
from diffsea.recordings.mapping_proposal.names import suggest_labels as suggest_labels
from diffsea.recordings.mapping_proposal.proposal import Proposal as Proposal
from diffsea.recordings.mapping_proposal.proposal import foreign_layouts as foreign_layouts
from diffsea.recordings.mapping_proposal.proposal import is_foreign as is_foreign
from diffsea.recordings.mapping_proposal.proposal import propose_mapping as propose_mapping
