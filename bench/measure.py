"""What the benches in Python share: the program, and the time and memory of a process."""
import datetime, os, signal, subprocess, sys, tempfile, threading, time

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def target():
    return os.environ.get('CARGO_TARGET_DIR', os.path.join(ROOT, 'target'))


def built():
    """-> the program, made where it is not up to date; CATOPTRIC names another"""
    if 'CATOPTRIC' in os.environ:
        return os.environ['CATOPTRIC']
    subprocess.check_call(['cargo', 'build', '--release', '-p', 'catoptric'], cwd=ROOT)
    return os.path.join(target(), 'release', 'catoptric')


def example(name):
    """-> an example of the end-to-end tests; PROFILE names another profile than `release`"""
    profile = os.environ.get('PROFILE', 'release')
    subprocess.check_call(['cargo', 'build', '--profile', profile, '-p', 'catoptric-tests', '--example', name], cwd=ROOT)
    return os.path.join(target(), profile, 'examples', name)


def in_venv(venv, packages):
    """Makes a Python environment with some packages if there is none, and runs this script in it."""
    python = os.path.join(venv, 'bin', 'python')
    if os.path.abspath(sys.prefix) == os.path.abspath(venv):
        return
    # Scripts may share one: each has its own mark.
    mark = os.path.join(venv, 'with-' + packages[0].split('=')[0])
    if not os.path.exists(mark):
        subprocess.check_call([sys.executable, '-m', 'venv', venv])
        subprocess.check_call([python, '-m', 'pip', 'install', '--quiet', *packages])
        open(mark, 'w').close()
    os.execv(python, [python, os.path.abspath(sys.argv[0]), *sys.argv[1:]])


def machine():
    """-> the date, and on what"""
    model = next((line.split(':', 1)[1].strip() for line in open('/proc/cpuinfo') if line.startswith('model name')), 'unknown processor')
    return f'{datetime.date.today()}, {os.cpu_count()} × {model}'


def timed(command, limit=None, env=None):
    """-> wall seconds, CPU seconds, peak memory in MB and standard error of a process, None where it took longer than `limit`"""
    with tempfile.TemporaryFile('w+') as errors:
        begin = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors, env=env)
        late = threading.Event()

        def stop():
            late.set()
            process.send_signal(signal.SIGKILL)
        timer = threading.Timer(limit or 1e6, stop)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        wall = time.perf_counter() - begin
        errors.seek(0)
        text = errors.read()
    if late.is_set():
        return None
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f'failed: {" ".join(command)}\n{text}')
    return dict(seconds=wall, cpu=usage.ru_utime + usage.ru_stime, mb=usage.ru_maxrss / 1024, errors=text)
