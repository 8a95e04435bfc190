"""``python -m planner_service`` is the command ``planner-service``."""

from planner_service.cli import main

if __name__ == "__main__":
    main()
