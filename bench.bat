@echo off
rem Opens the bench by a double click, on Windows (bench.command does so elsewhere). The first time it installs what the
rem bench needs into a folder next to this file. Options are those of capsbayes app. After an update, remove .bench.
cd /d "%~dp0"
if not exist .bench\installed (
    echo The bench is being installed. It takes some minutes and 1.2 GB, this once.
    py -3.13 -m venv .bench || py -3 -m venv .bench || goto failed
    .bench\Scripts\python -m pip install --quiet ".[app]" || goto failed
    type nul > .bench\installed
)
.bench\Scripts\python -m capsbayes app %*
if not errorlevel 1 exit /b 0
:failed
echo The bench could not be opened: the lines above say why. Python 3.11 or newer is needed, from python.org.
pause
exit /b 1
