# The public names, each once: type checkers read them here, and lazy_loader loads them at their first use.

from .calibration.calibrate import CalibratedConfig as CalibratedConfig
from .calibration.calibrate import calibrate as calibrate
from .config import Config as Config
from .config import load_config as load_config
from .dataset.generate import GenerationResult as GenerationResult
from .dataset.generate import generate as generate
from .dataset.pair_files import StoredFrame as StoredFrame
from .dataset.reader import Dataset as Dataset
from .dataset.reader import open_dataset as open_dataset
from .frame.camera import Crop as Crop
from .frame.camera import StereoCamera as StereoCamera
from .frame.channels import ViewArrays as ViewArrays
from .frame.frame import Frame as Frame
from .geometry.mesh import Mesh as Mesh
from .geometry.mesh import make_mesh as make_mesh
from .geometry.model_units import make_model as make_model
from .inputs.errors import BackendError as BackendError
from .inputs.errors import InputError as InputError
from .inputs.errors import SemisynthError as SemisynthError
from .judge.evaluate import evaluate as evaluate
from .judge.report import Report as Report
from .judge.report import report as report
from .judge.score import score as score
from .judge.verify import Verification as Verification
from .judge.verify import verify as verify
from .pairs.pipeline import Pair as Pair
from .pairs.pipeline import PairRenderer as PairRenderer
from .pairs.pipeline import render_pair as render_pair
from .render.renderer import Renderer as Renderer
from .scene.scene import Projector as Projector
from .scene.scene import Scene as Scene
from .scene.scene import SceneMotion as SceneMotion
from .scene.scene import make_scene as make_scene
from .scene.scene import move as move

__version__: str
