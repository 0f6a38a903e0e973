"""Recordings as a filter runs along them: one data set, several runs side by side."""

from diffsea.identification.data.dataset import Dataset as Dataset
from diffsea.identification.data.dataset import DatasetShape as DatasetShape
from diffsea.identification.data.dataset import make_dataset as make_dataset
