# The public names, each once. Type checkers read them here, and so does the package at the first use of one.

from semisynth_gl.calibration.calibrate import Calibration as Calibration
from semisynth_gl.calibration.calibrate import calibrate as calibrate
from semisynth_gl.config import Config as Config
from semisynth_gl.config import load_config as load_config
from semisynth_gl.dataset.generate import GenerationResult as GenerationResult
from semisynth_gl.dataset.generate import generate as generate
from semisynth_gl.dataset.reader import Dataset as Dataset
from semisynth_gl.dataset.reader import open_dataset as open_dataset
from semisynth_gl.dataset.sample import StoredFrame as StoredFrame
from semisynth_gl.frame.camera import Crop as Crop
from semisynth_gl.frame.camera import StereoCamera as StereoCamera
from semisynth_gl.frame.channels import View as View
from semisynth_gl.frame.frame import Frame as Frame
from semisynth_gl.geometry.mesh import Mesh as Mesh
from semisynth_gl.geometry.mesh import make_mesh as make_mesh
from semisynth_gl.geometry.model_units import make_model as make_model
from semisynth_gl.inputs.errors import BackendError as BackendError
from semisynth_gl.inputs.errors import InputError as InputError
from semisynth_gl.inputs.errors import SemisynthError as SemisynthError
from semisynth_gl.judge.evaluate import evaluate as evaluate
from semisynth_gl.judge.report import Report as Report
from semisynth_gl.judge.report import report as report
from semisynth_gl.judge.score import Score as Score
from semisynth_gl.judge.score import score as score
from semisynth_gl.judge.verify import Verification as Verification
from semisynth_gl.judge.verify import verify as verify
from semisynth_gl.pairs.pipeline import Pair as Pair
from semisynth_gl.pairs.pipeline import PairRenderer as PairRenderer
from semisynth_gl.pairs.pipeline import render_pair as render_pair
from semisynth_gl.render.renderer import Renderer as Renderer
from semisynth_gl.scene.scene import Motion as Motion
from semisynth_gl.scene.scene import Projector as Projector
from semisynth_gl.scene.scene import Scene as Scene
from semisynth_gl.scene.scene import make_scene as make_scene
from semisynth_gl.scene.scene import move as move

__version__: str
