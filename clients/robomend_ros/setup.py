"""For colcon; see package.xml."""

from setuptools import setup

NAME = "robomend_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/launch", ["launch/agent.launch.py", "launch/feeder.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The robomend maintainers",
    maintainer_email="maintainers@robomend.invalid",
    description="Feeds an agent of robomend, and acts for it",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "feeder = robomend_ros.feeder:main",
            "lifecycle = robomend_ros.lifecycle:main",
            "action = robomend_ros.action:main",
        ]
    },
)
