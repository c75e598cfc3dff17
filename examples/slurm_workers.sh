#!/usr/bin/env bash
# Many workers on one search, one per task of an array; each claims trials until the study is done:
#
#   sbatch --array=1-64 examples/slurm_workers.sh sweep=architecture hydra.sweeper.storage=postgresql://lab@db/lab
#
# The folder runs/ must be the same for all of them. A task that is stopped or killed loses nothing: another worker takes
# up its trial.
#SBATCH --job-name=pgdl_lab
#SBATCH --cpus-per-task=2
#SBATCH --time=08:00:00
#SBATCH --requeue
#SBATCH --output=runs/slurm_%A_%a.log
exec python -m pgdl_lab -m "$@" "hydra.sweeper.threads=${SLURM_CPUS_PER_TASK:-1}"
