from gonio import models
from gonio.errors import GonioError

try:
    models.get("wrad")
except GonioError as error:
    print(error)
    print("the value that was given:", error.value)
